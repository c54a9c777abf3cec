"""People, as far as one user sees them, and who is asking."""

import datetime
import uuid

from kleinkram.contract.wire import Response


class PersonRef(Response):
    """A person, as named beside what they did."""

    id: uuid.UUID
    name: str


class PersonRead(Response):
    """A person. `emails` are their verified addresses, for themselves, admins, and editors of a group that they are in.

    `deactivated_at` is when they left; only admins see those who did.
    """

    id: uuid.UUID
    name: str
    emails: list[str]
    is_admin: bool
    created_at: datetime.datetime
    deactivated_at: datetime.datetime | None


class Departure(Response):
    """What ended when somebody was deactivated, and the projects that went to the admins for want of another owner."""

    person: PersonRef
    sessions: int
    tokens: int
    links: int
    projects: list[str]


class ViewerRead(Response):
    """A page elsewhere that shows a recording; `{url}` in its `url` is replaced by the recording's, percent-encoded."""

    name: str
    url: str


class ServiceRead(Response):
    """What a server says of itself to whoever comes: `GET /api/v1/service`. `person` is who asks, where it is one.

    `name` is the lab's. `store_url` is where bytes are sent and fetched, `store_origin` how a browser names that place.
    """

    name: str
    version: str
    public_url: str
    store_url: str
    store_origin: str
    # A token that is made without an end is good for so long; `token_days_max` 0: a token may be good for ever.
    token_days_default: int = 0
    token_days_max: int = 0
    checksum: str
    has_local_accounts: bool
    viewers: list[ViewerRead]
    person: PersonRef | None
