"""Where a run finds what it was given and leaves what it made.

`/in`, `/out` and `/tmp`, unless the environment says otherwise: where no kernel can give a run a root of its own.
"""

import os
from pathlib import Path

IN_VARIABLE = "KLEINKRAM_IN"
OUT_VARIABLE = "KLEINKRAM_OUT"

given = Path(os.environ.get(IN_VARIABLE, "/in"))
out = Path(os.environ.get(OUT_VARIABLE, "/out"))
scratch = Path(os.environ.get("TMPDIR", "/tmp"))  # noqa: S108  the run's own
