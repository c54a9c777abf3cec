"""What a run is given beside its files, the same on a server's runner as with `klein action run-local`."""

import sys
from pathlib import Path

from kleinkram.contract.names import check_file_path
from kleinkram.contract.runs import CONTEXT_FILE, RunContext

_OWN_FOLDER = ".kleinkram"
_SCRIPT = f"{_OWN_FOLDER}/script.py"
# Whom the runner believes, for a run that may speak to the server: it may have a certificate of the lab's own.
AUTHORITIES = f"{_OWN_FOLDER}/authorities.pem"
# What a runner itself puts into `/in`.
_OWN = {CONTEXT_FILE, _OWN_FOLDER}


def check_place(path: str) -> str:
    """Return the path of a mission's file, as it can stand in `/in`.

    Raises:
        ValueError: it leaves the folder, or stands where a run finds what it is told.
    """
    path = check_file_path(path)
    if path.partition("/")[0] in _OWN:
        raise ValueError("stands where a run finds what it is told; rename it")
    return path


def write_given(folder: Path, context: RunContext, script: str | None, authorities: str | None = None) -> None:
    """Write `mission.json` into the folder that becomes `/in`, and beside it a script and certificates (PEM)."""
    (folder / CONTEXT_FILE).write_text(context.model_dump_json(indent=1))
    for name, text in ((_SCRIPT, script), (AUTHORITIES, authorities)):
        if text is not None:
            path = folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)


def script_command(dependencies: list[str], *, in_image: bool) -> list[str]:
    """Return what starts a script: the image's Python, or where there is none this one."""
    python = "python3" if in_image else sys.executable
    return [python, "-m", "kleinkram.action.launch", _SCRIPT, *dependencies]
