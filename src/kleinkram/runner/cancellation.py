"""How a run is stopped from outside while its thread works, and its lease. Thread-safe."""

import enum
import threading
from dataclasses import dataclass

from kleinkram.runner.executors.limits import boot_time_s

# A run is stopped this long before its lease ends, so that two runners never run it at once.
LEASE_MARGIN_S = 10.0


class StopRequest(str, enum.Enum):
    """Why a run is to stop; later members take precedence.

    `cancel`: a person cancelled it, and the server is told how it ended. `abandon`: another runner has it; nothing is
    reported. `detach`: this runner process ends, and the next one goes on with the run.
    """

    cancel = "cancel"
    abandon = "abandon"
    detach = "detach"


_PRECEDENCE = [None, *StopRequest]


@dataclass(eq=False)
class StopRequested(Exception):
    """A run is to stop; its thread ends what it does."""

    request: StopRequest


class StopSignal:
    """The stop requests of one run."""

    def __init__(self) -> None:
        self._changed = threading.Event()
        self._request: StopRequest | None = None
        self._is_acknowledged = False

    @property
    def request(self) -> StopRequest | None:
        """The current request."""
        return self._request

    def send(self, request: StopRequest) -> None:
        """Request a stop."""
        if _PRECEDENCE.index(request) > _PRECEDENCE.index(self._request):
            self._request = request
            self._is_acknowledged = False
            self._changed.set()

    def acknowledge(self) -> None:
        """Go on with what remains to be done after a request."""
        self._is_acknowledged = True
        self._changed.clear()

    def is_pending(self) -> bool:
        """Whether there is a request that was not acknowledged."""
        return self._request is not None and not self._is_acknowledged

    def check(self) -> None:
        """Raise `StopRequested` if a request is pending."""
        if self._request is not None and not self._is_acknowledged:
            raise StopRequested(self._request)

    def wait(self, seconds: float) -> None:
        """Wait, or raise `StopRequested` as soon as there is a request."""
        self._changed.wait(seconds)
        self.check()


class Lease:
    """How long a run belongs to this runner, by the clock of `boot_time_s`."""

    def __init__(self, until_s: float) -> None:
        self.until_s = until_s

    def renew(self, requested_s: float, lease_s: float) -> None:
        """Extend it: the server renewed it by the reply to a request sent at `requested_s`."""
        self.until_s = max(self.until_s, requested_s + lease_s - LEASE_MARGIN_S)

    def is_over(self) -> bool:
        """Whether another runner may soon have the run."""
        return boot_time_s() > self.until_s
