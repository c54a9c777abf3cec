"""All files of a mission on one axis of time, in as few bytes as that takes."""

import uuid
from typing import Annotated

from pydantic import Field

from kleinkram.contract.files import BlobState, ContentState
from kleinkram.contract.wire import Response

MAX_TIMELINE_FILES = 10_000

TimelineSize = Annotated[int, Field(ge=1, le=MAX_TIMELINE_FILES)]


class TimelineFile(Response):
    """When one file was recorded; `start_ns` and `end_ns` are null where it has no times, or nobody read it yet."""

    id: uuid.UUID
    path: str
    recording_id: uuid.UUID | None
    start_ns: int | None
    end_ns: int | None
    size_bytes: int
    content: ContentState
    state: BlobState


class MissionTimeline(Response):
    """Files of a mission, by path; `next` is the cursor of those that follow, or null.

    `start_ns` and `end_ns` span the mission (log clock, since 1970, UTC), without recordings from before 1990.
    """

    start_ns: int | None
    end_ns: int | None
    items: list[TimelineFile]
    next: str | None = None
