"""What a process that was forked for a script runs, as `python SCRIPT` does."""

import os
import runpy
import sys
from pathlib import Path


def main() -> None:
    """Run the script that the command line names."""
    del sys.argv[0]
    packages = [
        folder for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep) if folder not in ("", *sys.path)
    ]
    sys.path[:0] = [str(Path(sys.argv[0]).parent), *packages]
    runpy.run_path(sys.argv[0], run_name="__main__")
