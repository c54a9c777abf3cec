"""A transfer adapts to its network link and reports its state."""

import contextlib
import errno
import gc
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
import urllib3

from kleinkram.client import _network
from kleinkram.client._http import Backoff
from kleinkram.client._network import NetworkMonitor, WatchedConnection, WatchedPools, has_address
from kleinkram.client.errors import ServerUnreachable
from kleinkram.client.transfer import plan_download, store
from kleinkram.client.transfer.download import fetch
from kleinkram.client.transfer.pool import CALM_S, QUICK_S, SLOW_S, CongestionWindow, Stop
from kleinkram.client.transfer.report import LinkReport, OutageReporter, Watcher, diagnose, is_silence
from kleinkram.contract.files import DownloadLink
from kleinkram.contract.uploads import MIN_PART_BYTES as PART
from tests.api_objects import file_read
from tests.ports import choose_port

_CONNECTIONS = 4


class Clock:
    """A clock that is set by the test."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_a_fast_link_is_fully_used_after_several_parts(clock: Clock) -> None:
    window = CongestionWindow(_CONNECTIONS, Stop(), clock=clock)
    assert window.limit_bytes == PART
    for _ in range(_CONNECTIONS):
        window.arrived(PART, 0.05)
    assert window.limit_bytes == _CONNECTIONS * PART


def test_a_slow_link_carries_one_part_at_a_time(clock: Clock) -> None:
    window = CongestionWindow(_CONNECTIONS, Stop(), clock=clock)
    for _ in range(4):
        clock.now += QUICK_S + 5
        window.arrived(PART, QUICK_S + 5)
    assert window.limit_bytes == PART


def test_a_slow_but_steady_link_tries_one_more_part(clock: Clock) -> None:
    window = CongestionWindow(_CONNECTIONS, Stop(), clock=clock)
    clock.now += CALM_S
    window.arrived(PART, QUICK_S + 5)
    assert window.limit_bytes == 2 * PART
    window.arrived(PART, SLOW_S + 5)
    assert window.limit_bytes == PART


def test_a_lost_connection_leaves_one_part_and_the_link_grows_again(clock: Clock) -> None:
    window = CongestionWindow(_CONNECTIONS, Stop(), clock=clock)
    for _ in range(_CONNECTIONS):
        window.arrived(PART, 0.05)
    window.lost()
    window.arrived(PART, QUICK_S - 1)
    assert window.limit_bytes == PART
    window.arrived(PART, 0.05)
    assert window.limit_bytes == 2 * PART
    clock.now += CALM_S
    window.arrived(PART, QUICK_S - 1)
    assert window.limit_bytes == 3 * PART


def test_many_small_files_may_go_at_once_on_any_link(clock: Clock) -> None:
    window = CongestionWindow(_CONNECTIONS, Stop(), clock=clock)
    for _ in range(100):
        window.arrived(10_000, 1.0)
        assert window.limit_bytes >= _CONNECTIONS * 10_000


def test_a_small_part_does_not_shrink_the_window(clock: Clock) -> None:
    window = CongestionWindow(_CONNECTIONS, Stop(), clock=clock)
    for _ in range(_CONNECTIONS):
        window.arrived(8 * PART, 0.5)
    assert window.limit_bytes >= _CONNECTIONS * 7 * PART
    window.arrived(1000, 0.05)
    assert window.limit_bytes >= _CONNECTIONS * 7 * PART


def test_large_parts_are_judged_by_their_rate(clock: Clock) -> None:
    window = CongestionWindow(_CONNECTIONS, Stop(), clock=clock)
    window.arrived(100 * PART, 10.0)
    assert window.limit_bytes > 100 * PART


def test_interrupted_parts_are_sent_before_new_ones() -> None:
    window = CongestionWindow(_CONNECTIONS, Stop())
    order: list[str] = []
    is_waiting = threading.Event()

    def second() -> None:
        with window.slot() as slot:
            is_waiting.set()
            with window.acquire(slot, PART):
                order.append("second")

    with window.slot() as slot:
        with window.acquire(slot, PART):
            thread = threading.Thread(target=second)
            thread.start()
            is_waiting.wait()
        window.lost()
        with window.acquire(slot, PART):
            order.append("first again")
    thread.join(10)
    assert order == ["first again", "second"]


def test_a_failed_part_waits_for_the_others() -> None:
    window = CongestionWindow(_CONNECTIONS, Stop())
    with window.slot() as failing:
        window.leave(failing)
        with window.slot() as other, window.acquire(other, PART):
            pass
        with window.acquire(failing, PART):
            pass


def _outages(clock: Clock) -> tuple[OutageReporter, list[str]]:
    messages: list[str] = []
    return OutageReporter(messages.append, clock=clock), messages


def _backoff() -> Backoff:
    return Backoff(10.0, lambda _: None)


def test_a_silent_network_is_reported_once(clock: Clock) -> None:
    outages, messages = _outages(clock)
    for _ in range(4):
        outages.lost("http://store:9000/b/k?signature=x", _backoff(), TimeoutError(), "it took too long")
    assert messages == ["no answer for 15 s from store:9000, reconnecting"]
    clock.now += 20
    outages.arrived()
    assert messages[1:] == ["connected again after 35 s"]
    assert outages.report() == LinkReport(connections_lost=4, longest_outage_s=35.0)


def test_a_changed_address_is_reported_and_reconnected_from_at_once(clock: Clock) -> None:
    outages, messages = _outages(clock)
    outages.network_changed("10.0.0.7")
    assert outages.is_network_changed()
    outages.lost("http://store", _backoff(), ConnectionResetError(), "reset", resent_bytes=1_500_000)
    assert messages == ["this machine no longer has the address 10.0.0.7 (another network?), reconnecting"]
    clock.now += 2
    assert not outages.is_network_changed()
    advice = outages.report().advice()
    assert advice is not None
    assert "network changed 1 time" in advice
    assert "1.5 MB had to be sent again" in advice


def test_a_connection_replaced_at_once_is_not_reported(clock: Clock) -> None:
    outages, messages = _outages(clock)
    outages.lost("http://store", _backoff(), ConnectionResetError(), "reset")
    outages.arrived()
    assert messages == []


def test_a_good_link_needs_no_advice() -> None:
    assert LinkReport().advice() is None


@pytest.mark.parametrize(
    ("error", "silent"),
    [
        (TimeoutError(), True),
        (OSError(errno.ETIMEDOUT, "Connection timed out"), True),
        (OSError(errno.EHOSTUNREACH, "No route to host"), True),
        (urllib3.exceptions.ProtocolError("broken", OSError(errno.ECONNRESET, "reset")), False),
        (ConnectionRefusedError(errno.ECONNREFUSED, "refused"), False),
        (None, False),
    ],
)
def test_timeouts_count_as_silence_and_resets_do_not(error: BaseException | None, silent: bool) -> None:
    assert is_silence(error) is silent


def _refused() -> BaseException:
    pools = WatchedPools(maxsize=1, timeout=urllib3.Timeout(1))
    with pytest.raises(urllib3.exceptions.HTTPError) as caught:
        pools.request("GET", f"http://127.0.0.1:{choose_port()}/")
    return caught.value


def _unconnected(cause: OSError) -> BaseException:
    connection = WatchedConnection("store", 9000)
    error = urllib3.exceptions.NewConnectionError(connection, f"Failed to establish a new connection: {cause}")
    error.__cause__ = cause
    return error


def test_a_store_that_refuses_connections_is_not_silent(clock: Clock) -> None:
    outages, messages = _outages(clock)
    outages.lost("http://store:9000/b/k", _backoff(), _refused(), "Connection refused")
    assert messages == []
    clock.now += 20
    outages.arrived()
    assert outages.report().longest_outage_s == 20


@pytest.mark.parametrize(
    "cause",
    [
        OSError(errno.ENETUNREACH, "Network is unreachable"),
        OSError(errno.EHOSTUNREACH, "No route to host"),
        socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution"),
    ],
)
def test_a_missing_network_is_reported(clock: Clock, cause: OSError, monkeypatch: pytest.MonkeyPatch) -> None:
    outages, messages = _outages(clock)
    backoff = _backoff()
    error = _unconnected(cause)
    outages.lost("http://store:9000/b/k", backoff, error, str(cause.strerror))
    assert messages == [], "this may pass in a moment"
    monkeypatch.setattr(backoff, "lasting_s", lambda: 6.0)
    outages.lost("http://store:9000/b/k", backoff, error, str(cause.strerror))
    assert messages == [
        f"this machine cannot reach store:9000 ({cause.strerror}): it may have no network; trying again"
    ]


def test_an_error_caused_by_a_timeout_counts_as_silence() -> None:
    wrapping = urllib3.exceptions.ProtocolError("Connection broken")
    wrapping.__cause__ = OSError(errno.ETIMEDOUT, "Connection timed out")
    assert is_silence(wrapping)


def test_addresses_of_this_machine_are_recognised() -> None:
    assert has_address(("127.0.0.1", 1234))
    assert not has_address(("192.0.2.77", 1234))


def test_connections_stay_if_addresses_cannot_be_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    def cannot(*_: object) -> socket.socket:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket, "socket", cannot)
    assert has_address(("127.0.0.1", 1234))


def test_connections_may_be_collected_by_a_thread_that_looks_at_others(listening: Callable[[], str]) -> None:
    def look() -> None:
        pool = WatchedPools(maxsize=1, timeout=urllib3.Timeout(1)).connection_from_url(listening())
        connection = pool._get_conn()
        connection.connect()
        pool._put_conn(connection)
        cycle: list[object] = [pool]
        cycle.append(cycle)
        del pool, connection, cycle
        with _network._lock:
            gc.collect()

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    thread.join(10)
    assert not thread.is_alive()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts a busy peer as a silent one")
def test_a_busy_store_is_not_treated_as_dead() -> None:
    listener = socket.create_server(("127.0.0.1", 0))
    connection = WatchedConnection(*listener.getsockname(), socket_options=[*_network.socket_options()])
    connection.connect()
    busy, _ = listener.accept()
    with listener, busy, NetworkMonitor(lambda _: None):
        connection.sock.setblocking(False)
        sent_bytes = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                sent_bytes += connection.sock.send(bytes(1 << 20))
        _wait_for_patience(connection, at_least_s=60)
        busy.settimeout(10)
        while sent_bytes > 0:
            sent_bytes -= len(busy.recv(1 << 20))
        _wait_for_patience(connection, at_least_s=0)
    connection.close()


def _wait_for_patience(connection: WatchedConnection, *, at_least_s: int) -> None:
    """Wait until the kernel lets the other side be silent for more than `at_least_s` and less than a minute more."""
    gives_up_at = time.monotonic() + 60
    while True:
        patience_s = connection.sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) / 1000
        if at_least_s < patience_s <= at_least_s + 60:
            return
        assert time.monotonic() < gives_up_at, patience_s
        time.sleep(0.05)


@pytest.fixture
def listening() -> Iterator[Callable[[], str]]:
    sockets: list[socket.socket] = []

    def listen() -> str:
        sockets.append(socket.create_server(("127.0.0.1", 0)))
        return f"http://127.0.0.1:{sockets[-1].getsockname()[1]}/bucket"

    yield listen
    for connection in sockets:
        connection.close()


def test_the_diagnosis_names_what_does_not_answer(listening: Callable[[], str]) -> None:
    works, dead = listening(), f"http://127.0.0.1:{choose_port()}"
    one = diagnose(works, dead)
    assert one.startswith(f"the store ({dead.removeprefix('http://')}) cannot be reached: Connection refused")
    assert "the server (127.0.0.1" in one
    assert "Look at this machine's network first" in diagnose(dead, dead)
    assert "the name 'nowhere.invalid' cannot be resolved" in diagnose("http://nowhere.invalid", None)
    assert diagnose(works, works).startswith("Both can be reached again")
    assert diagnose(works, None).startswith("It can be reached again")


def test_a_transfer_without_a_connection_names_what_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = f"http://127.0.0.1:{choose_port()}"
    messages: list[str] = []

    class MessageRecorder(Watcher):
        def notify(self, text: str) -> None:
            messages.append(text)

    def links(_: object) -> Sequence[DownloadLink]:
        raise ServerUnreachable(url=server, reason="Connection refused")

    monkeypatch.setattr(store, "TRANSFER_RETRY_S", 0.0)
    with pytest.raises(ServerUnreachable):
        fetch(links, server, plan_download([file_read("a")], tmp_path), watcher=MessageRecorder())
    assert "cannot be reached: Connection refused" in messages[-1]
