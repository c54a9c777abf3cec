"""Locks the dependencies of scripts: which versions, with which hashes, on all platforms and versions of Python."""

import contextlib
import importlib.metadata
import tempfile
from collections.abc import Sequence
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from kleinkram.contract.locks import OWN_DISTRIBUTION, check_lock, parse_lock, parse_requirement
from kleinkram.environments.uv import PackageIndex, UvFailed, Wait, run_uv

# A client waits longer for an answer.
LOCK_TIMEOUT_S = 40.0
_OLDEST_PYTHON = (3, 10)
_NEWEST_MINOR = 30
_PATCH_RELEASES = 100


class CannotLock(ValueError):
    """The dependencies of a script cannot be locked, or its lock is not one of them. The text is a sentence."""


def third_party(dependencies: Sequence[str]) -> list[Requirement]:
    """Return the dependencies that must be installed: those that are not the library, and those of its extras.

    Raises:
        CannotLock: one is not a package of an index.
    """
    try:
        requirements = [parse_requirement(dependency) for dependency in dependencies]
    except ValueError as error:
        raise CannotLock(f"The dependency {error}.") from None
    result = []
    for requirement in requirements:
        if canonicalize_name(requirement.name) != OWN_DISTRIBUTION:
            result.append(requirement)
        for extra in requirement.extras if canonicalize_name(requirement.name) == OWN_DISTRIBUTION else ():
            result += _own_requirements(extra)
    return result


def core_requirements() -> list[Requirement]:
    """Return what the library needs to be imported in a script, which no lock may contradict."""
    return _own_requirements("")


def _own_requirements(extra: str) -> list[Requirement]:
    """Return what the library requires: without an extra, or only for one."""
    requirements = []
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        for text in importlib.metadata.requires(OWN_DISTRIBUTION) or ():
            requirement = Requirement(text)
            is_for_extra = requirement.marker is not None and "extra" in str(requirement.marker)
            if not extra and not is_for_extra:
                requirements.append(requirement)
            elif extra and is_for_extra and requirement.marker and requirement.marker.evaluate({"extra": extra}):
                requirement.marker = None
                requirements.append(requirement)
    return requirements


def check_own_lock(lock: str, dependencies: Sequence[str]) -> None:
    """Check a lock that its author made.

    Raises:
        CannotLock: it does not contain the dependencies, or contradicts what the library needs.
    """
    try:
        packages = parse_lock(lock)
        check_lock(packages, third_party(dependencies))
        core = {str(canonicalize_name(requirement.name)): requirement for requirement in core_requirements()}
        for package in packages:
            if package.name in core and not core[package.name].specifier.contains(package.version, prereleases=True):
                raise CannotLock(
                    f"The lock contains {package.name}=={package.version}, "
                    f"but kleinkram.action needs {core[package.name]}."
                )
    except CannotLock:
        raise
    except ValueError as error:
        raise CannotLock(f"The lock {error}.") from None


def lock_dependencies(
    dependencies: Sequence[str], index: PackageIndex, wait: Wait, *, requires_python: str | None = None
) -> str | None:
    """Return the lock of dependencies, with what they depend on; None where nothing must be installed.

    Takes seconds, at most `LOCK_TIMEOUT_S`; `wait` (seconds) is called meanwhile.

    Raises:
        CannotLock: a package or version does not exist, has no wheel, or contradicts another; no index answers.
    """
    requirements = third_party(dependencies)
    if not requirements:
        return None
    python = oldest_python(requires_python)
    with tempfile.TemporaryDirectory(prefix="klein-lock-") as name:
        folder = Path(name)
        (folder / "requirements.in").write_text("".join(f"{requirement}\n" for requirement in requirements))
        (folder / "core.txt").write_text("".join(f"{requirement}\n" for requirement in core_requirements()))
        arguments = [
            *("pip", "compile", "--quiet", "--universal", "--generate-hashes", "--only-binary", ":all:"),
            *("--no-annotate", "--no-header", "--no-emit-index-url", "--python-version", python),
            *("--constraints", str(folder / "core.txt")),
            *("--output-file", str(folder / "lock.txt"), str(folder / "requirements.in")),
        ]
        try:
            run_uv(arguments, index, folder=folder, timeout_s=LOCK_TIMEOUT_S, wait=wait)
            lock = (folder / "lock.txt").read_text()
            check_lock(parse_lock(lock), requirements)
        except UvFailed as error:
            raise CannotLock(str(error)) from None
        except ValueError as error:
            raise CannotLock(f"The lock that uv made {error}.") from None
    return lock


def oldest_python(requires_python: str | None) -> str:
    """Return the oldest version of Python that a script accepts, such as `3.10`, which is the oldest of all.

    Raises:
        CannotLock: it accepts none.
    """
    accepted = SpecifierSet(requires_python or "")
    for minor in range(_OLDEST_PYTHON[1], _NEWEST_MINOR):
        # Any patch release: `>=3.11.2` and `==3.11.4` accept 3.11.
        if any(accepted.contains(f"3.{minor}.{patch}") for patch in range(_PATCH_RELEASES)):
            return f"3.{minor}"
    raise CannotLock(f"No version of Python fulfils requires-python = {requires_python!r} (3.10 is the oldest here).")
