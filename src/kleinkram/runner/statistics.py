"""What a runner counts for its metrics. Thread-safe; needs no library of Prometheus, which few runners have."""

import threading
import time
from collections import Counter

from kleinkram.contract.runs import EndReason

_STATES = {EndReason.done: "done", EndReason.cancelled: "cancelled"}


class RunnerStatistics:
    """Counters since the start, and when the server last answered."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ends = Counter[str]()
        self._errors = Counter[str]()
        self._input_bytes = Counter[str]()
        self.last_contact_s = 0.0

    def count_end(self, reason: EndReason | None) -> None:
        """Count a run that this runner ended, or with None one that it lost."""
        with self._lock:
            self._ends["lost" if reason is None else _STATES.get(reason, "failed")] += 1

    def count_inputs(self, source: str, size_bytes: int) -> None:
        """Count bytes of inputs from the `store` or the `cache`."""
        with self._lock:
            self._input_bytes[source] += size_bytes

    def count_answer(self) -> None:
        """Record that the server answered."""
        self.last_contact_s = time.time()

    def count_error(self, request: str) -> None:
        """Count a `claim` or a `heartbeat` that failed."""
        with self._lock:
            self._errors[request] += 1

    def ends(self) -> dict[str, int]:
        """Return the number of ended runs by state."""
        with self._lock:
            return dict(self._ends)

    def errors(self) -> dict[str, int]:
        """Return the number of failed requests to the server."""
        with self._lock:
            return dict(self._errors)

    def input_bytes(self) -> dict[str, int]:
        """Return the bytes of inputs by their source."""
        with self._lock:
            return dict(self._input_bytes)
