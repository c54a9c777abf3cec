"""Actions that a project names: they run by themselves, and their results count for the verdicts of its missions."""

import datetime
import enum
import uuid
from typing import Annotated

from pydantic import Field, model_validator
from typing_extensions import Self

from kleinkram.contract.actions import ParameterValues
from kleinkram.contract.base import Request, Response
from kleinkram.contract.people import PersonRef
from kleinkram.contract.runs import ActionRef

DEFAULT_IDLE_S = 600


class RunTrigger(str, enum.Enum):
    """When an action runs: once a mission is marked complete, or once its files have not changed for some time."""

    complete = "complete"
    idle = "idle"


class ProjectActionAdd(Request):
    """An action that a project names, by the id of a published one. The latest version runs.

    `idle_s` is for `idle` only: how long the files of a mission must not have changed, and no upload be under way.
    """

    action_id: uuid.UUID
    on: RunTrigger
    idle_s: Annotated[int, Field(ge=1, le=30 * 86_400)] | None = None
    parameters: ParameterValues = {}

    @model_validator(mode="after")
    def _has_a_time_if_idle(self) -> Self:
        if self.idle_s is not None and self.on is not RunTrigger.idle:
            raise ValueError("only `idle` has an `idle_s`")
        return self


class ProjectActionRead(Response):
    """An action that a project names. Its runs act for `added_by`, with their rights at that time.

    `problem` is why it last did not run on a mission that was due, and `problem_count` on how many missions.
    """

    action: ActionRef
    on: RunTrigger
    idle_s: int | None
    parameters: ParameterValues
    added_by: PersonRef
    added_at: datetime.datetime
    problem: str | None
    problem_count: int


class ProjectActionList(Response):
    """The actions that a project names, by name."""

    items: list[ProjectActionRead]
