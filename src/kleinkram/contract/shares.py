"""Shares: links to a mission, or to some of its files, for people without an account."""

import datetime
import uuid
from typing import Annotated

from pydantic import Field

from kleinkram.contract.expiry import Expiry
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.names import Label
from kleinkram.contract.people import PersonRef
from kleinkram.contract.wire import Request, Response

# The page of the server's that a link opens; the secret follows behind a `#`, where no log sees it.
SHARE_PAGE = "/s"
MAX_SHARED_FILES = 2_000


def is_link(text: str) -> bool:
    """Say whether a text is the address of a link."""
    return text.startswith(("http://", "https://")) and f"{SHARE_PAGE}#" in text


class ShareCreate(Request):
    """A link to make: to files of the mission, or with `file_ids` null to all that is in it now and later."""

    name: Label
    file_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=MAX_SHARED_FILES)] | None = None
    expires_at: Expiry


class ShareRead(Response):
    """A link without its secret; `prefix` is how that begins.

    `file_count` is null for a link to a whole mission. Downloads are addresses given out, a file each, and their bytes.
    """

    id: uuid.UUID
    name: str
    mission: MissionRef
    file_count: int | None
    prefix: str
    created_by: PersonRef
    created_at: datetime.datetime
    expires_at: datetime.datetime
    revoked_at: datetime.datetime | None
    last_used_at: datetime.datetime | None
    download_count: int
    download_bytes: int


class ShareMade(Response):
    """A new link with its secret, which nobody can show again. `url` holds the secret, too."""

    share: ShareRead
    url: Annotated[str, Field(repr=False)]
    secret: Annotated[str, Field(repr=False)]


class SharedRead(Response):
    """What a link shows, as seen by whoever has it: `file_count` and `size_bytes` of what it shows now."""

    name: str
    mission: MissionRef
    is_whole: bool
    file_count: int
    size_bytes: int
    expires_at: datetime.datetime
