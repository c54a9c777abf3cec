"""Starts a script action: `python -m kleinkram.action.launch SCRIPT DEPENDENCY…`, with SCRIPT relative to `/in`.

Checks first that the dependencies of the script are installed, because a run cannot install packages.
"""

import importlib.metadata
import runpy
import sys

from packaging.requirements import InvalidRequirement, Requirement

from kleinkram.action import run_files

NOT_INSTALLED = 78  # EX_CONFIG of sysexits.h


def main() -> None:
    """Run the script in this process; exit with `NOT_INSTALLED` where a dependency is missing."""
    _, script, *dependencies = sys.argv
    missing = [problem for dependency in dependencies if (problem := _missing(dependency))]
    if missing:
        sys.stderr.write(
            f"Dependencies of this script are not installed here: {'; '.join(missing)}. A run cannot install packages: "
            "set an image that has them in the script's header ([tool.kleinkram] image = ...).\n"
        )
        raise SystemExit(NOT_INSTALLED)
    # Without a sandbox, `/in` is another directory.
    path = str(run_files.in_dir / script)
    sys.argv = [path]
    runpy.run_path(path, run_name="__main__")


def _missing(dependency: str) -> str | None:
    try:
        requirement = Requirement(dependency)
    except InvalidRequirement:
        return f"{dependency!r}, which is not a valid requirement"
    if requirement.marker is not None and not requirement.marker.evaluate():
        return None
    try:
        version = importlib.metadata.version(requirement.name)
    except importlib.metadata.PackageNotFoundError:
        return dependency
    if requirement.specifier.contains(version, prereleases=True):
        return None
    return f"{dependency} (version {version} is installed)"


if __name__ == "__main__":
    main()
