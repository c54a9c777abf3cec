"""The client: one connection, one attribute a noun."""

import importlib
import logging
from types import TracebackType
from typing import TYPE_CHECKING

from typing_extensions import Self

from kleinkram.client._http import Api
from kleinkram.client.config import Endpoint, find_endpoint

if TYPE_CHECKING:
    from kleinkram.client.access import Access
    from kleinkram.client.actions import Actions
    from kleinkram.client.admin import Admin
    from kleinkram.client.audit import Audit
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
    """A connection to one Kleinkram server. A context manager; may be shared between threads.

    A noun is loaded when it is first asked for: whoever lists projects does not wait for all the others.
    """

    projects: "Projects"
    missions: "Missions"
    files: "Files"
    recordings: "Recordings"
    uploads: "Uploads"
    actions: "Actions"
    runs: "Runs"
    runners: "Runners"
    access: "Access"
    groups: "Groups"
    people: "People"
    tokens: "Tokens"
    shares: "Shares"
    trash: "Trash"
    stats: "Stats"
    search: "Search"
    audit: "Audit"
    service: "Service"
    events: "Events"
    home: "Home"
    admin: "Admin"
    me: "Me"

    def __init__(self, endpoint: Endpoint) -> None:
        self._api = Api(endpoint)
        self.endpoint = endpoint

    if not TYPE_CHECKING:  # or any attribute would be one

        def __getattr__(self, noun: str) -> object:
            kind = Client.__annotations__.get(noun)
            if kind is None:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {noun!r}")
            made = getattr(importlib.import_module(f"kleinkram.client.{noun}"), kind)(self._api)
            setattr(self, noun, made)
            return made

    def __dir__(self) -> list[str]:
        return [*{*super().__dir__(), *Client.__annotations__}]

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
