"""What a run was given."""

import functools
from pathlib import Path

from kleinkram.action import places
from kleinkram.contract.actions import ParameterValues
from kleinkram.contract.runs import CONTEXT_FILE, RunContext


@functools.cache
def context() -> RunContext:
    """Return what `/in/mission.json` says.

    Raises:
        FileNotFoundError: this is not inside of a run; `klein action run-local` makes one.
    """
    return RunContext.model_validate_json((places.given / CONTEXT_FILE).read_bytes())


def inputs() -> list[Path]:
    """Return the files of the run, by their paths in the mission. They can be read and nothing else."""
    return [places.given / file.path for file in context().files]


def parameters() -> ParameterValues:
    """Return the value of each parameter, defaults included."""
    return context().parameters
