"""Layouts of the mission viewer: sets of panels that a project's missions can be viewed with."""

import datetime
import uuid
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from kleinkram.contract.base import ETag, Request, Response, etag_of
from kleinkram.contract.names import Name, check_text
from kleinkram.contract.people import PersonRef

MAX_PANELS = 16
MAX_PANEL_CHARACTERS = 2000
# Of the shared ones of a project, and of those that one person has in it.
MAX_VIEWER_LAYOUTS = 50

PanelText = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=MAX_PANEL_CHARACTERS)]
Panels = Annotated[list[PanelText], Field(min_length=1, max_length=MAX_PANELS)]


class ViewerLayoutCreate(Request):
    """A layout to add to a project. A personal one is visible to its creator only.

    `panels` are texts as the addresses of the viewer have them. Instead of a recording, each names a place among the
    recordings that have the topic, from 1 on: `plot:1@/imu,linear_acceleration.x`.
    """

    name: Name
    panels: Panels
    is_shared: bool = False


class ViewerLayoutUpdate(Request):
    """Changes of a layout; omitted fields stay. A project has one default: the one before ends."""

    name: Name | None = None
    panels: Panels | None = None
    is_default: bool | None = None


def _etag(values: dict[str, Any]) -> str:
    return etag_of(*(values[name] for name in ("name", "panels", "is_default")))


class ViewerLayoutRead(Response):
    """A layout of the viewer. The viewer shows the default of a project where its address names no panels.

    `created_by` is null for callers without an account. `etag` covers the edited fields: a change with an outdated one
    is refused.
    """

    id: uuid.UUID
    project_id: uuid.UUID
    name: str
    panels: list[str]
    is_shared: bool
    is_default: bool
    created_at: datetime.datetime
    created_by: PersonRef | None
    etag: ETag = Field(default_factory=_etag)
