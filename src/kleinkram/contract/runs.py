"""Runs: executions of an action on a mission."""

import enum
import uuid
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from kleinkram.contract.actions import ParameterValues
from kleinkram.contract.files import FileRead, RecordingRead, TopicRead
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.people import PersonRef

CONTEXT_FILE = "mission.json"


class EndReason(str, enum.Enum):
    """Why a run is over. `exit_code`: the command said so itself; all after it are not the command's word."""

    done = "done"
    exit_code = "exit_code"
    signal = "signal"
    memory = "memory"
    time = "time"
    disk = "disk"
    cancelled = "cancelled"
    command_not_found = "command_not_found"
    image_unavailable = "image_unavailable"
    not_possible = "not_possible"
    broken_report = "broken_report"
    lost = "lost"


class ActionRef(BaseModel):
    """An action in one version; `version` is null where it is run from a folder that nobody has published."""

    model_config = ConfigDict(frozen=True)

    name: str
    version: Annotated[int, Field(ge=1)] | None


class Cause(BaseModel):
    """Why a run is: who asked for it."""

    model_config = ConfigDict(frozen=True)

    person: PersonRef | None = None


class RunContext(BaseModel):
    """What `/in/mission.json` says: the mission, the files that the run gets with what is known of them, and its task.

    `run_id` is null where no server knows of the run. `topics` are of the files, `recordings` of the mission.
    """

    model_config = ConfigDict(frozen=True)

    contract: Literal[1] = 1
    run_id: uuid.UUID | None
    action: ActionRef
    parameters: ParameterValues
    cause: Cause
    mission: MissionRead
    files: list[FileRead]
    topics: list[TopicRead]
    recordings: list[RecordingRead]
