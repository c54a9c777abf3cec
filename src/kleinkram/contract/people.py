"""People and their personal data, the description of a server, and the rules for e-mail addresses."""

import datetime
import enum
import re
import uuid
from typing import Annotated

from pydantic import AfterValidator, Field, JsonValue

from kleinkram.contract.base import NamedRef, Request, Response
from kleinkram.contract.isolation import Isolation


class PersonRef(NamedRef):
    """The id and name of a person."""


class PersonRead(Response):
    """A person. `emails`, their verified addresses, are for themselves, admins, and editors of a shared group.

    Only admins see deactivated people. The `name` of an erased person is a pseudonym.
    """

    id: uuid.UUID
    name: str
    emails: list[str]
    is_admin: bool
    created_at: datetime.datetime
    deactivated_at: datetime.datetime | None
    erased_at: datetime.datetime | None = None


class Departure(Response):
    """What ended when a person was deactivated, and the projects that went to the admins."""

    person: PersonRef
    sessions: int
    tokens: int
    links: int
    projects: list[str]


class PersonErase(Request):
    """Erase a person: `POST /people/{id}/erase`. `confirmation` is their name, as typed by the admin."""

    confirmation: Annotated[str, Field(max_length=200)]


class MentionPlace(str, enum.Enum):
    """The kind of an object with a text that contains somebody's name or address."""

    project = "project"
    mission = "mission"
    file = "file"
    action = "action"
    run = "run"
    group = "group"
    share = "share"


class Mention(Response):
    """A text in which a person's name or address is found: which of its fields, and of which object.

    The `name` of a run is that of its mission.
    """

    resource_type: MentionPlace
    id: uuid.UUID
    name: str
    fields: list[str]


class Erasure(Response):
    """What the erasure of a person ended, and where their name is still mentioned, which stays as it is.

    `audit_events` is the number of events in which it was replaced; null until a job has done that. The counts and
    mentions are null when the person was erased before.
    """

    person: PersonRef
    erased_at: datetime.datetime
    sessions: int | None = None
    tokens: int | None = None
    links: int | None = None
    projects: list[str] | None = None
    mentions: list[Mention] | None = None
    audit_events: int | None


class DataSection(str, enum.Enum):
    """A kind of data that is kept of a person, in the order of an export."""

    account = "account"
    addresses = "addresses"
    identities = "identities"
    sign_in = "sign_in"
    sessions = "sessions"
    tokens = "tokens"
    logins = "logins"
    invitations = "invitations"
    groups = "groups"
    rights = "rights"
    links = "links"
    runners = "runners"
    projects = "projects"
    missions = "missions"
    uploads = "uploads"
    files = "files"
    checks = "checks"
    mission_events = "mission_events"
    viewer_layouts = "viewer_layouts"
    actions = "actions"
    runs = "runs"
    mentions = "mentions"
    audit_events = "audit_events"


class PersonalData(Response):
    """One record of `GET /people/{id}/export`, without secrets. Records of a section follow one another."""

    section: DataSection
    record: dict[str, JsonValue]


class ViewerRead(Response):
    """An external page that shows a recording; `{url}` in its `url` stands for the recording's, percent-encoded."""

    name: str
    url: str


class MapTiles(Response):
    """The tiles of maps: `{z}`, `{x}` and `{y}` in `url` stand for zoom, column and row (Web Mercator, 256 pixels).

    Nearer than `max_zoom`, those of `max_zoom` are enlarged. `attribution` is to be shown beside the map.
    """

    url: str
    attribution: str
    max_zoom: int


class ServiceRead(Response):
    """A server: `GET /api/v1/service`. `name` is the lab's; `person` is the caller, if they have an account.

    Bytes are sent to and fetched from `store_url`; `store_origin` is its origin in browsers. `token_days_max` 0: tokens
    without an end are allowed. `weakest_isolation`: the weakest that owners of projects may allow for runs.
    `map_tiles`: where pages get the tiles of maps, if that is set.
    """

    name: str
    version: str
    public_url: str
    store_url: str
    store_origin: str
    token_days_default: int = 0
    token_days_max: int = 0
    weakest_isolation: Isolation = Isolation.container
    checksum: str
    has_local_accounts: bool
    viewers: list[ViewerRead]
    map_tiles: MapTiles | None = None
    person: PersonRef | None


MAX_EMAIL_CHARACTERS = 254

# Source: RFC 5321, section 4.1.2, dot-string local parts and domains of letters, digits and hyphens.
_LOCAL = r"[A-Za-z0-9!#$%&'*+/=?^_`{|}~-]+(\.[A-Za-z0-9!#$%&'*+/=?^_`{|}~-]+)*"
_DOMAIN = r"[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*"
_ADDRESS = re.compile(f"{_LOCAL}@{_DOMAIN}")
_WHOLE_DOMAIN = re.compile(_DOMAIN)


def check_email(address: str) -> str:
    """Return an address if it is valid ASCII, as `name@domain`. Raises ValueError."""
    if len(address) > MAX_EMAIL_CHARACTERS or not _ADDRESS.fullmatch(address):
        raise ValueError("is not an address such as ada@lab.example (a domain beyond ASCII is written as xn--…)")
    return address


def check_domain(domain: str) -> str:
    """Return a domain in lower case. Raises ValueError."""
    if not _WHOLE_DOMAIN.fullmatch(domain):
        raise ValueError("is not a domain such as lab.example, without @ and wildcards")
    return domain.lower()


def email_key(address: str) -> str:
    """Return the form under which an address is unique: in lower case."""
    return address.lower()


def email_domain(address: str) -> str:
    """Return the domain of an address, in lower case."""
    return address.rpartition("@")[2].lower()


EmailAddress = Annotated[str, AfterValidator(check_email), Field(min_length=3, max_length=MAX_EMAIL_CHARACTERS)]
EmailDomain = Annotated[str, AfterValidator(check_domain), Field(min_length=1, max_length=253)]
