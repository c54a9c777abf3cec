"""Previews of missions: the pictures, tables and tracks that the latest runs made of them."""

import datetime
import enum
import uuid
from typing import Annotated

from pydantic import Field

from kleinkram.contract.base import Request, Response
from kleinkram.contract.runs import ActionRef

MAX_MISSION_PREVIEWS = 100
MAX_PICTURED_MISSIONS = 200
# Of a picture in a list of missions.
MAX_LISTED_PICTURE_BYTES = 4_000_000
# The action whose previews come first.
PREVIEW_ACTION = "preview"


class PreviewKind(str, enum.Enum):
    """What a preview shows, by the ending of its path: PNG, JPEG or SVG; CSV; GeoJSON; or none of these."""

    picture = "picture"
    table = "table"
    track = "track"
    other = "other"


PICTURE_ENDINGS = ("png", "jpg", "jpeg", "svg")
_KINDS = {
    **dict.fromkeys(PICTURE_ENDINGS, PreviewKind.picture),
    "csv": PreviewKind.table,
    **dict.fromkeys(("geojson", "json"), PreviewKind.track),
}


def preview_kind(path: str) -> PreviewKind:
    """Return what the artifact with this path can show."""
    return _KINDS.get(path.rpartition(".")[2].lower(), PreviewKind.other)


class MissionPreview(Response):
    """An artifact that the latest run of an action shows of its mission.

    `run_id` is the run that made it at `made_at`, which a later one may reuse. `outdated`: what the action reads has
    changed since: files, or the metadata, checks and reference that it declares.
    """

    run_id: uuid.UUID
    action: ActionRef
    made_at: datetime.datetime
    outdated: bool
    artifact_id: uuid.UUID
    path: str
    title: str
    kind: PreviewKind
    size_bytes: int
    sha256: str


class MissionPreviews(Response):
    """The first 100 previews of a mission: those of the action `preview`, then those that were made last.

    Of each action, by its name, these are the previews of the latest run that is done and has any. Those whose bytes
    are lost or corrupt are left out. `truncated`: there are more.
    """

    items: Annotated[list[MissionPreview], Field(max_length=MAX_MISSION_PREVIEWS)]
    truncated: bool


class PicturesRequest(Request):
    """The missions of a list."""

    mission_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=MAX_PICTURED_MISSIONS)]


class MissionPicture(Response):
    """The first picture of a mission of at most 4 MB, with a URL to GET it from before `expires_at`."""

    mission_id: uuid.UUID
    run_id: uuid.UUID
    artifact_id: uuid.UUID
    path: str
    title: str
    size_bytes: int
    url: str
    expires_at: datetime.datetime


class MissionThumbnail(Response):
    """A picture that a camera recorded in a mission, of at most 160 by 160 pixels: a JPEG in base64."""

    mission_id: uuid.UUID
    file_id: uuid.UUID
    jpeg: str


class MissionPictures(Response):
    """The pictures of those missions that have one, in no order; of the others, a thumbnail if cameras recorded."""

    items: list[MissionPicture]
    thumbnails: list[MissionThumbnail]
