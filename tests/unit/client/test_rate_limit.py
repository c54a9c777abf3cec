"""The bandwidth limit is not exceeded."""

from kleinkram.client._http import LONGEST_WAIT_S, Backoff
from kleinkram.client.transfer.pool import RateLimit


class Clock:
    """A clock that moves with each wait."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def wait(self, seconds: float) -> None:
        self.now += seconds


def test_the_rate_limit_is_not_exceeded() -> None:
    clock = Clock()
    pace = RateLimit(1000, clock=clock)
    for _ in range(50):
        pace.spend(100, clock.wait)
    assert 4.5 <= clock.now - 100 <= 5.0


def test_idle_time_does_not_raise_the_rate() -> None:
    clock = Clock()
    pace = RateLimit(1000, clock=clock)
    clock.now += 3600
    began = clock.now
    pace.spend(5000, clock.wait)
    assert clock.now - began >= 4.5


def test_no_limit_never_waits() -> None:
    clock = Clock()
    RateLimit(None, clock=clock).spend(10**12, clock.wait)
    assert clock.now == 100


def test_waits_grow_and_end() -> None:
    waits: list[float] = []
    backoff = Backoff(3600, waits.append)
    for _ in range(8):
        assert backoff.pause()
    assert waits[0] <= 0.25
    assert max(waits) <= LONGEST_WAIT_S
    assert waits[-1] > waits[0]
    assert Backoff(3600, waits.append).pause(at_least_s=20)
    assert waits[-1] == 20
    assert not Backoff(0, waits.append).pause()
    assert not Backoff(1, waits.append).pause(at_least_s=20)
