"""How long an operation is retried."""

from kleinkram.client._http import LONGEST_WAIT_S, Backoff


def test_the_retry_timeout_excludes_other_waits() -> None:
    waits: list[float] = []
    backoff = Backoff(0.0, waits.append)
    assert not backoff.pause()
    backoff.extend(10 * LONGEST_WAIT_S)
    assert backoff.pause()
    assert len(waits) == 1
