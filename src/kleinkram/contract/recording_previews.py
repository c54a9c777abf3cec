"""Previews of recordings: small files, from which a client shows a recording before it reads any of its bytes."""

import datetime
import enum
import uuid

from kleinkram.contract.base import Response


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
