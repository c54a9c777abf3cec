"""Locks the dependencies of scripts that are published or run: outside of transactions, since it asks a package index.

At most two at once in a process; a request that would wait too long is refused.
"""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.errors import FieldProblem, InvalidRequest
from kleinkram.environments.lock import LOCK_TIMEOUT_S, CannotLock, check_own_lock, lock_dependencies, third_party
from kleinkram.environments.uv import PackageIndex, parse_index
from kleinkram.server.settings import Settings

_AT_ONCE = 2
_LONGEST_WAIT_S = LOCK_TIMEOUT_S + 10
_pool = ThreadPoolExecutor(_AT_ONCE, "lock")


class _Abandoned(Exception):
    """The request that wanted a lock is over."""


def needs_lock(definition: ActionDefinition, settings: Settings) -> bool:
    """Whether a definition must be locked: it has dependencies and no lock, and there is a package index.

    Raises:
        InvalidRequest: a dependency is not a package of an index, or its own lock is not one of its dependencies.
    """
    try:
        if definition.lock is not None:
            check_own_lock(definition.lock, definition.dependencies)
            return False
        return bool(parse_index(settings.package_index) and third_party(definition.dependencies))
    except CannotLock as error:
        raise _refusal(str(error)) from None


async def lock(definition: ActionDefinition, settings: Settings) -> ActionDefinition:
    """Return a definition with a lock, which takes seconds; unchanged where it needs none.

    Raises:
        InvalidRequest: its dependencies cannot be locked.
    """
    index = parse_index(settings.package_index)
    if index is None or not needs_lock(definition, settings):
        return definition
    is_over = threading.Event()
    work = asyncio.get_running_loop().run_in_executor(_pool, partial(_lock, definition, index, is_over))
    try:
        made = await asyncio.wait_for(work, _LONGEST_WAIT_S)
    except CannotLock as error:
        raise _refusal(str(error)) from None
    except asyncio.TimeoutError:
        raise _refusal("The server locks other actions at the moment. Try again in a minute.") from None
    finally:
        is_over.set()
    return definition.model_copy(update={"lock": made})


def _lock(definition: ActionDefinition, index: PackageIndex, is_over: threading.Event) -> str | None:
    def wait(seconds: float) -> None:
        if is_over.wait(seconds):
            raise _Abandoned

    requires_python = definition.requires_python
    return lock_dependencies(definition.dependencies, index, wait, requires_python=requires_python)


def _refusal(message: str) -> InvalidRequest:
    return InvalidRequest(problems=[FieldProblem(field="definition.dependencies", message=message)])
