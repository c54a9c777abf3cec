"""Messages to systemd: only a loop that runs is reported as alive."""

import asyncio
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from kleinkram.runner import loop
from kleinkram.systemd import Watchdog, notify_ready, notify_stopping
from tests.integration.runner_loop.conftest import Runners, wait_until
from tests.integration.runner_loop.fake_server import FakeServer

_PING_S = 0.05


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """A service manager that expects pings."""
    name = str(tmp_path / "notify")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(name)
    monkeypatch.setenv("NOTIFY_SOCKET", name)
    monkeypatch.setenv("WATCHDOG_USEC", str(round(_PING_S * 4e6)))
    with listener:
        yield listener


def _received(listener: socket.socket, *, within_s: float = 0) -> list[str]:
    """Return what has arrived, or arrives in time."""
    deadline, messages = time.monotonic() + within_s, []
    with suppress(TimeoutError, BlockingIOError):
        while True:
            listener.settimeout(max(0.0, deadline - time.monotonic()))
            messages.append(listener.recv(4096).decode())
    return messages


def test_messages_have_the_form_of_sd_notify(manager: socket.socket) -> None:
    notify_ready("serving")
    notify_stopping()
    assert _received(manager) == ["READY=1\nSTATUS=serving", "STOPPING=1\nSTATUS=stopping"]


def test_the_socket_may_be_abstract(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"klein-test-{os.getpid()}"
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0{name}")
        notify_stopping()
        assert _received(listener) == ["STOPPING=1\nSTATUS=stopping"]


def test_an_event_loop_that_hangs_does_not_ping(manager: socket.socket) -> None:
    hangs, goes_on = threading.Event(), threading.Event()

    async def work() -> None:
        pings = asyncio.create_task(Watchdog().ping_from_event_loop())
        await asyncio.sleep(3 * _PING_S)
        hangs.set()
        await asyncio.sleep(0)
        goes_on.wait(20)  # blocks the event loop: what the watchdog is for
        await asyncio.sleep(2 * _PING_S)
        pings.cancel()

    thread = threading.Thread(target=asyncio.run, args=(work(),))
    thread.start()
    assert hangs.wait(20)
    assert "WATCHDOG=1" in _received(manager, within_s=_PING_S)
    assert _received(manager, within_s=4 * _PING_S) == []
    goes_on.set()
    thread.join(20)
    assert "WATCHDOG=1" in _received(manager)


def test_pings_are_not_sent_more_often_than_needed(manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "60000000")
    watchdog = Watchdog()
    for _ in range(1000):
        watchdog.ping()
    assert _received(manager) == ["WATCHDOG=1"]


@pytest.mark.parametrize(
    "variables", [{"WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "x"}, {"NOTIFY_SOCKET": "/no/such"}]
)
def test_nothing_is_sent_that_nobody_expects(
    manager: socket.socket, monkeypatch: pytest.MonkeyPatch, variables: dict[str, str]
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    Watchdog().ping()
    assert _received(manager) == []


def test_a_runner_whose_requests_hang_does_not_ping(
    manager: socket.socket,
    server: FakeServer,
    runners: Runners,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # No run comes, so that its request for one waits longer than this.
    monkeypatch.setattr(loop, "_HANGS_S", 2.0)
    runners.start()
    wait_until(lambda: "WATCHDOG=1" in _received(manager))
    wait_until(lambda: _received(manager, within_s=0.5) == [])
