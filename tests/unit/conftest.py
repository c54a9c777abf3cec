"""A guard: a unit test starts no process, opens no socket, and neither writes nor reads a file over 1 MB."""

import os
import resource
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

_FORBIDDEN_EVENTS = frozenset(
    {"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.system", "socket.connect", "socket.bind"}
)
_MAX_FILE_BYTES = 1_000_000
_violations: set[str] = set()
_is_guarding = False
# The threads that earlier tests of this process left behind.
_others: set[int | None] = set()


def _check(event: str, arguments: tuple[object, ...]) -> None:
    # False outside unit tests; no more than None at the end of the process, when modules lose their names.
    if not _is_guarding or threading.get_ident() in _others:
        return
    if event in _FORBIDDEN_EVENTS:
        _violations.add(event)
    elif event == "open" and isinstance(path := arguments[0], (str, bytes)):
        try:
            is_large = Path(os.fsdecode(path)).stat().st_size > _MAX_FILE_BYTES
        except OSError:
            return
        if is_large and not Path(os.fsdecode(path)).is_relative_to(sys.prefix):
            _violations.add(f"open({os.fsdecode(path)})")


sys.addaudithook(_check)


@pytest.fixture(autouse=True)
def _refuse_integration() -> Iterator[None]:
    """Fail a test that uses what belongs into an integration test."""
    global _is_guarding
    _others.clear()
    _others.update(thread.ident for thread in threading.enumerate() if thread is not threading.current_thread())
    _violations.clear()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (_MAX_FILE_BYTES, hard))
    _is_guarding = True
    yield
    _is_guarding = False
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not _violations, f"a unit test must not use {', '.join(sorted(_violations))}: move it to tests/integration"
