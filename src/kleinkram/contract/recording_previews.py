"""Previews of recordings: small files, from which a client shows a recording before it reads any of its bytes."""

import datetime
import enum
import uuid
from typing import Annotated

from pydantic import Field

from kleinkram.contract.base import Request, Response

MAX_THUMBNAIL_FILES = 200


class RecordingPreviewState(str, enum.Enum):
    """State of the preview of a file."""

    none = "none"  # none was made: no recording, a small one, or the setting is off
    making = "making"
    ready = "ready"
    failed = "failed"
    deleted = "deleted"  # by a person; it is made again only on request


class RecordingPreviewRead(Response):
    """The preview of a recording file, whose format the page on formats describes.

    `url` is there if `state` is `ready`: GET the bytes from it before `expires_at`, with or without a Range header.
    `reason` says why it failed. Files with the same bytes share one preview.
    """

    file_id: uuid.UUID
    state: RecordingPreviewState
    reason: str | None = None
    version: int | None = None
    size_bytes: int | None = None
    made_at: datetime.datetime | None = None
    url: str | None = None
    expires_at: datetime.datetime | None = None


class ThumbnailsRequest(Request):
    """The files of a list."""

    file_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=MAX_THUMBNAIL_FILES)]


class FileThumbnail(Response):
    """A picture that a camera recorded in a file, of at most 160 by 160 pixels: a JPEG in base64."""

    file_id: uuid.UUID
    jpeg: str


class FileThumbnails(Response):
    """The thumbnails of those files that have one, in no order."""

    items: list[FileThumbnail]
