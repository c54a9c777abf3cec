"""What all runs of a runner share; and of each run its stop requests and its lease, both thread-safe."""

import enum
import threading
from collections.abc import Callable
from dataclasses import dataclass

from kleinkram.client.runs import Runners
from kleinkram.client.server import Service
from kleinkram.client.transfer.store import StoreClient
from kleinkram.runner.executors.base import Executor
from kleinkram.runner.executors.limits import boot_time_s

# A run is stopped this long before its lease ends, so that two runners never run it at once.
LEASE_MARGIN_S = 10.0


@dataclass(frozen=True)
class RunnerContext:
    """Context shared by all runs of a runner. `on_change` is called when the state of a run changes."""

    executor: Executor
    runners: Runners
    store: StoreClient
    url: str
    token: str
    service: Service
    default_image: str | None
    on_change: Callable[[], None]


class StopRequest(str, enum.Enum):
    """Why a run is to stop; later members take precedence.

    `cancel`: a person cancelled it; its end is reported. `abandon`: another runner has it; nothing is reported.
    `detach`: this runner process ends, and the next one continues the run.
    """

    cancel = "cancel"
    abandon = "abandon"
    detach = "detach"


_PRECEDENCE = [None, *StopRequest]


@dataclass(eq=False)
class StopRequested(Exception):
    """Raised in the thread of a run that is to stop."""

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
        """Clear a request, so that what remains to be done is not interrupted by it."""
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
    """Lease of a run, by the clock of `boot_time_s`."""

    def __init__(self, until_s: float) -> None:
        self.until_s = until_s

    def renew(self, requested_s: float, lease_s: float) -> None:
        """Extend it: the server renewed it by the reply to a request sent at `requested_s`."""
        self.until_s = max(self.until_s, requested_s + lease_s - LEASE_MARGIN_S)

    def is_over(self) -> bool:
        """Whether another runner may soon have the run."""
        return boot_time_s() > self.until_s
