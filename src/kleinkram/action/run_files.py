"""The directories of a run and the content of `/in/mission.json`.

The directories are `/in`, `/out` and `/tmp`, unless the environment sets others, as it does without a sandbox.
"""

import functools
import os
from pathlib import Path

from kleinkram.contract.actions import ParameterValues
from kleinkram.contract.runs import CONTEXT_FILE, RunContext

IN_VARIABLE = "KLEINKRAM_IN"
OUT_VARIABLE = "KLEINKRAM_OUT"
# The folder of the packages that were installed for the script; not set where there are none.
PACKAGES_VARIABLE = "KLEINKRAM_PACKAGES"

in_dir = Path(os.environ.get(IN_VARIABLE, "/in"))
out = Path(os.environ.get(OUT_VARIABLE, "/out"))
scratch = Path(os.environ.get("TMPDIR", "/tmp"))  # noqa: S108  the run's own


@functools.cache
def context() -> RunContext:
    """Return the content of `/in/mission.json`.

    Raises:
        FileNotFoundError: this process is not in a run; `klein action run-local` starts one.
    """
    return RunContext.model_validate_json((in_dir / CONTEXT_FILE).read_bytes())


def inputs() -> list[Path]:
    """Return the input files of the run, by their paths in the mission. They are read-only."""
    return [in_dir / file.path for file in context().files]


def parameters() -> ParameterValues:
    """Return the value of each parameter, defaults included."""
    return context().parameters
