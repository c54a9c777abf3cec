"""Starts a script action: `python -m kleinkram.action.launch SCRIPT DEPENDENCY…`, SCRIPT as in `/in`.

Looks whether what the script says it depends on is installed, since a run can fetch nothing, and then is the script.
"""

import importlib.metadata
import runpy
import sys

from packaging.requirements import InvalidRequirement, Requirement

from kleinkram.action import places

NOT_INSTALLED = 78  # EX_CONFIG of sysexits.h


def main() -> None:
    """Run the script in this process, or say what is missing and exit with `NOT_INSTALLED`."""
    _, script, *dependencies = sys.argv
    missing = [problem for each in dependencies if (problem := _missing(each))]
    if missing:
        sys.stderr.write(
            f"This script needs what is not installed here: {'; '.join(missing)}. A run cannot fetch packages: "
            "name an image that has them in the script's header ([tool.kleinkram] image = ...).\n"
        )
        raise SystemExit(NOT_INSTALLED)
    # Without a root of its own, a run is told elsewhere where its `/in` is.
    path = str(places.given / script)
    sys.argv = [path]
    runpy.run_path(path, run_name="__main__")


def _missing(dependency: str) -> str | None:
    try:
        wanted = Requirement(dependency)
    except InvalidRequirement:
        return f"{dependency!r}, which is no requirement"
    if wanted.marker is not None and not wanted.marker.evaluate():
        return None
    try:
        version = importlib.metadata.version(wanted.name)
    except importlib.metadata.PackageNotFoundError:
        return dependency
    return None if wanted.specifier.contains(version, prereleases=True) else f"{dependency} (here is {version})"


if __name__ == "__main__":
    main()
