"""Locks of dependencies: pip requirements, each with one version and the SHA-256 of its files, for all platforms.

A lock has no options, URLs or includes, so that what it names can only come from a package index or a wheel folder.
Source: pip, "Requirements File Format", and "Hash-checking Mode".
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from packaging.markers import Marker, UndefinedComparison
from packaging.requirements import InvalidRequirement, Requirement
from packaging.specifiers import InvalidSpecifier, SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion

MAX_LOCKED_PACKAGES = 1000
# Provided by the machine or image where a script runs, in the version of its runner.
OWN_DISTRIBUTION = "open-kleinkram"

_PINNED = re.compile(r"^\s*([A-Za-z0-9][A-Za-z0-9._-]*)\s*==\s*([^\s;\\]+)", re.MULTILINE)
_HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}")
# A line break in a marker would begin a line of its own in a file of requirements.
_CONTROL = re.compile("[\x00-\x08\x0a-\x1f\x7f-\x9f\u2028\u2029]")


class LockedPackage(NamedTuple):
    """A package of a lock: its canonical name, its only version, and the marker of where it is needed."""

    name: str
    version: str
    marker: Marker | None

    def is_needed(self, environment: Mapping[str, str]) -> bool:
        """Whether it is needed in this environment of markers."""
        try:
            return self.marker is None or self.marker.evaluate(dict(environment))
        except (UndefinedComparison, InvalidVersion):
            return True  # the installation says what is wrong with the marker


def parse_requirement(text: str) -> Requirement:
    """Return a dependency of a script.

    Raises:
        ValueError: it is not one of a package index.
    """
    try:
        requirement = Requirement(text)
        # As it is written to a file of requirements; a marker may have escaped characters.
        if _CONTROL.search(str(requirement)):
            raise ValueError("it contains a line break or another control character")
    except (InvalidRequirement, ValueError) as error:
        raise ValueError(f"{text!r} is not a requirement: {' '.join(str(error).split())}") from None
    if requirement.url is not None:
        raise ValueError(f"{text!r} names a URL; packages come from the package index")
    return requirement


def parse_lock(text: str) -> list[LockedPackage]:
    """Return the packages of a lock.

    Raises:
        ValueError: a line is not a version with hashes.
    """
    packages = []
    for number, line in _logical_lines(text):
        words, *hashes = re.split(r"\s+(?=--)", line)
        try:
            requirement = parse_requirement(words)
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from None
        pins = [specifier for specifier in requirement.specifier if specifier.operator == "=="]
        if len(requirement.specifier) != 1 or not pins or "*" in pins[0].version or requirement.extras:
            raise ValueError(f"line {number}: {words!r} is not one version of a package (name==version)")
        if not hashes or not all(_HASH.fullmatch(entry.strip()) for entry in hashes):
            raise ValueError(
                f"line {number}: {words!r} must be followed by hashes (--hash=sha256:...), and nothing else"
            )
        packages.append(LockedPackage(canonicalize_name(requirement.name), pins[0].version, requirement.marker))
    if not packages:
        raise ValueError("contains no package")
    if len(packages) > MAX_LOCKED_PACKAGES:
        raise ValueError(f"contains {len(packages)} packages; {MAX_LOCKED_PACKAGES} are allowed")
    return packages


def pinned_versions(lock: str | None) -> list[str]:
    """Return the versions in a lock that was checked before, such as `evo==1.38.1`, without reading all of it."""
    return [*dict.fromkeys(f"{canonicalize_name(name)}=={version}" for name, version in _PINNED.findall(lock or ""))]


def check_lock(packages: Sequence[LockedPackage], requirements: Iterable[Requirement]) -> None:
    """Check that each requirement is locked, in versions that it allows. The library itself is never locked.

    Raises:
        ValueError: one is not.
    """
    versions: dict[str, list[str]] = {}
    for package in packages:
        versions.setdefault(package.name, []).append(package.version)
    if OWN_DISTRIBUTION in versions:
        raise ValueError(f"contains {OWN_DISTRIBUTION}, which is part of where scripts run")
    for requirement in requirements:
        name = canonicalize_name(requirement.name)
        if name == OWN_DISTRIBUTION:
            continue
        if name not in versions:
            raise ValueError(f"does not match the dependencies: {requirement} is not locked")
        for version in versions[name]:
            if not requirement.specifier.contains(version, prereleases=True):
                raise ValueError(f"does not match the dependencies: {requirement} is locked as {name}=={version}")


def check_python_versions(text: str) -> str:
    """Return a `requires-python` of a script.

    Raises:
        ValueError: it is not a list of version conditions.
    """
    try:
        SpecifierSet(text)
    except InvalidSpecifier:
        raise ValueError(f"{text!r} is not a condition on the version of Python, such as '>=3.11'") from None
    return text


def _logical_lines(text: str) -> Iterable[tuple[int, str]]:
    """Yield the lines that are not empty, continued ones joined and without comments, by the number of their first."""
    pending, first = "", 0
    for number, raw in enumerate(text.splitlines(), start=1):
        line = re.sub(r"(^|\s)#.*$", "", raw).strip()
        first = first if pending else number
        if line.endswith("\\"):
            pending += line[:-1].rstrip() + " "
            continue
        if (pending + line).strip():
            yield first, (pending + line).strip()
        pending = ""
    if pending.strip():
        yield first, pending.strip()
