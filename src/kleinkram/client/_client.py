"""The client: one connection, one attribute a noun."""

import logging
from types import TracebackType

from typing_extensions import Self

from kleinkram.client._http import Api
from kleinkram.client.access import Access
from kleinkram.client.actions import Actions
from kleinkram.client.admin import Admin
from kleinkram.client.audit import Audit
from kleinkram.client.config import Endpoint, find_endpoint
from kleinkram.client.events import Events
from kleinkram.client.files import Files
from kleinkram.client.groups import Groups
from kleinkram.client.home import Home
from kleinkram.client.me import Me
from kleinkram.client.missions import Missions
from kleinkram.client.people import People
from kleinkram.client.projects import Projects
from kleinkram.client.recordings import Recordings
from kleinkram.client.runners import Runners
from kleinkram.client.runs import Runs
from kleinkram.client.search import Search
from kleinkram.client.service import Service
from kleinkram.client.shares import Shares
from kleinkram.client.stats import Stats
from kleinkram.client.tokens import Tokens
from kleinkram.client.trash import Trash
from kleinkram.client.uploads import Uploads

_log = logging.getLogger("kleinkram")


class Client:
    """A connection to one Kleinkram server. A context manager; may be shared between threads."""

    def __init__(self, endpoint: Endpoint) -> None:
        api = Api(endpoint)
        self._api = api
        self.endpoint = endpoint
        self.projects = Projects(api)
        self.missions = Missions(api)
        self.files = Files(api)
        self.recordings = Recordings(api)
        self.uploads = Uploads(api)
        self.actions = Actions(api)
        self.runs = Runs(api)
        self.runners = Runners(api)
        self.access = Access(api)
        self.groups = Groups(api)
        self.people = People(api)
        self.tokens = Tokens(api)
        self.shares = Shares(api)
        self.trash = Trash(api)
        self.stats = Stats(api)
        self.search = Search(api)
        self.audit = Audit(api)
        self.service = Service(api)
        self.events = Events(api)
        self.home = Home(api)
        self.admin = Admin(api)
        self.me = Me(api)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._api.close()


def connect(url: str | None = None, token: str | None = None) -> Client:
    """Return a client for a server: the one given, else the one configured, else this user's own instance.

    No request is made yet. See `kleinkram.client.config` for the order of places that are asked. The address of a link
    is a server with the link's secret. Where no token is known, one comes as a stranger, who reads public projects.

    Raises:
        NotConfigured: no server is known.
    """
    endpoint = find_endpoint(url, token)
    if endpoint.token is None:
        _log.warning("No token for %s: only what is public there is shown (klein login gets one).", endpoint.url)
    return Client(endpoint)
