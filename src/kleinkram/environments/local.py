"""Environments on the machine of an action's author: for `klein action run-local` and tests of actions."""

import os

import platformdirs

from kleinkram.contract.actions import ActionDefinition
from kleinkram.environments.cache import EnvironmentCache
from kleinkram.environments.lock import check_own_lock, lock_dependencies
from kleinkram.environments.uv import INDEX_VARIABLE, PYPI, PackageIndex, Wait, parse_index

_LIMIT_BYTES = 10 * 10**9


def local_index(text: str | None = None) -> PackageIndex | None:
    """Return a package index, by default that of `KLEINKRAM_PACKAGE_INDEX`, else PyPI; None where it is `off`.

    Raises:
        ValueError: it is neither the URL of an index nor a folder.
    """
    return parse_index(text or os.environ.get(INDEX_VARIABLE) or PYPI)


def local_environments(index: PackageIndex) -> EnvironmentCache:
    """Return the environments of this user."""
    return EnvironmentCache(platformdirs.user_cache_path("kleinkram") / "environments", index, _LIMIT_BYTES)


def with_lock(definition: ActionDefinition, index: PackageIndex | None, wait: Wait) -> ActionDefinition:
    """Return a definition with its lock, which is made where it has none; without an index, unchanged.

    Raises:
        CannotLock: its dependencies cannot be locked, or its own lock is not one of them.
    """
    if definition.lock is not None:
        check_own_lock(definition.lock, definition.dependencies)
        return definition
    if index is None:
        return definition
    requires_python = definition.requires_python
    lock = lock_dependencies(definition.dependencies, index, wait, requires_python=requires_python)
    return definition.model_copy(update={"lock": lock})
