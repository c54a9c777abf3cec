"""Starts a script action: `python -m kleinkram.action.launch SCRIPT DEPENDENCY…`, with SCRIPT relative to `/in`.

Checks first that the dependencies of the script are installed, because a run cannot install packages. Those that its
runner installed are in the folder of `PACKAGES_VARIABLE`, which is on PYTHONPATH, so before those of the image.
"""

import importlib.metadata
import os
import runpy
import site
import sys
from collections.abc import Sequence

from packaging.requirements import InvalidRequirement, Requirement

from kleinkram.action import run_files

NOT_INSTALLED = 78  # EX_CONFIG of sysexits.h


def main() -> None:
    """Run the script in this process; exit with `NOT_INSTALLED` where a dependency is missing."""
    _, script, *dependencies = sys.argv
    if packages := os.environ.get(run_files.PACKAGES_VARIABLE):
        # It is on the path already; this processes its .pth files.
        site.addsitedir(packages)
    if missing := find_missing(dependencies, sys.path):
        sys.stderr.write(
            f"Dependencies of this script are not installed here: {'; '.join(missing)}. A run cannot install packages: "
            "publish the script with a lock, or set an image that has them in its header ([tool.kleinkram] "
            "image = ...).\n"
        )
        raise SystemExit(NOT_INSTALLED)
    # Without a sandbox, `/in` is another directory.
    path = str(run_files.in_dir / script)
    sys.argv = [path]
    runpy.run_path(path, run_name="__main__")


def find_missing(dependencies: Sequence[str], path: Sequence[str]) -> list[str]:
    """Return those dependencies that are not installed in the folders of `path`, with the version that is."""
    return [problem for dependency in dependencies if (problem := _problem_of(dependency, [*path]))]


def _problem_of(dependency: str, path: list[str]) -> str | None:
    try:
        requirement = Requirement(dependency)
    except InvalidRequirement:
        return f"{dependency!r}, which is not a valid requirement"
    if requirement.marker is not None and not requirement.marker.evaluate():
        return None
    installed = next(iter(importlib.metadata.distributions(name=requirement.name, path=path)), None)
    if installed is None:
        return dependency
    if requirement.specifier.contains(installed.version, prereleases=True):
        return None
    return f"{dependency} (version {installed.version} is installed)"


if __name__ == "__main__":
    main()
