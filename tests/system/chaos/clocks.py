"""Clocks that are wrong: of a person's programs, or of the server's processes while store and database have it right.

By libfaketime, which is loaded before a program's own libraries; monotonic time goes on as it is.
"""

import importlib.util
from pathlib import Path

from tests.requirements import missing

_LIBRARY = "vendor/libfaketime/src/libfaketime.so.1"
# Python looks for this module at its start. What is not the server's stays at the right time, as the supervisor must:
# it sets up the store by its own clock, which is the same machine's.
_AT_START = """
import os, sys
if "kleinkram.server" in sys.orig_argv and "LD_PRELOAD" not in os.environ:
    os.environ.update({wrong!r})
    os.execv(sys.executable, sys.orig_argv)
"""


def wrong_clock(hours: float) -> dict[str, str]:
    """Return the variables of a program whose clock is `hours` ahead; skip if libfaketime is missing."""
    spec = importlib.util.find_spec("libfaketime")
    library = Path(spec.origin).parent / _LIBRARY if spec and spec.origin else None
    if library is None or not library.exists():
        missing("clocks are set wrong by libfaketime, which has no build for this machine")
    return {"LD_PRELOAD": str(library), "FAKETIME": f"{hours:+g}h", "FAKETIME_DONT_FAKE_MONOTONIC": "1"}


def wrong_at_server(folder: Path, hours: float) -> dict[str, str]:
    """Return the variables of a `klein up` whose API and worker have a wrong clock; `folder`: its configuration."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(_AT_START.format(wrong=wrong_clock(hours)))
    return {"PYTHONPATH": str(folder)}
