"""What a run is told from outside while its thread is at work, and how long it is held. From any thread."""

import enum
import threading
from dataclasses import dataclass
from pathlib import Path

from kleinkram.runner.disk import write_over
from kleinkram.runner.ward import HELD, now_s

# What a run is ended by, so that two never run at once: so long before its lease can run out.
MARGIN_S = 10.0


class Order(str, enum.Enum):
    """What a run is told; a later one here outdoes an earlier.

    `cancel`: somebody wants it ended, and the server is told how it did. `let_go`: it is not ours; nothing is told.
    `leave`: this runner ends, and the next one finds it as it is.
    """

    cancel = "cancel"
    let_go = "let_go"
    leave = "leave"


_RANK = [None, *Order]


@dataclass(eq=False)
class Told(Exception):
    """A run was told to end; its thread stops whatever it is at."""

    order: Order


class Orders:
    """The orders of one run."""

    def __init__(self) -> None:
        self._news = threading.Event()
        self._order: Order | None = None
        self._is_obeyed = False

    @property
    def order(self) -> Order | None:
        """What it was told."""
        return self._order

    def give(self, order: Order) -> None:
        """Tell it."""
        if _RANK.index(order) > _RANK.index(self._order):
            self._order = order
            self._is_obeyed = False
            self._news.set()

    def obeyed(self) -> None:
        """Go on with what is left to do after an order."""
        self._is_obeyed = True
        self._news.clear()

    def is_pending(self) -> bool:
        """Whether there is an order that was not obeyed yet."""
        return self._order is not None and not self._is_obeyed

    def check(self) -> None:
        """Raise `Told` where there is an order that was not obeyed yet."""
        if self._order is not None and not self._is_obeyed:
            raise Told(self._order)

    def wait(self, seconds: float) -> None:
        """Wait so long, or raise `Told` as soon as there is an order."""
        self._news.wait(seconds)
        self.check()


class Lease:
    """How long a run is ours, by a clock that nobody sets and that goes on while the machine sleeps.

    It is written down beside the run, so that what watches the run ends it when this runner is gone.
    """

    def __init__(self, until_s: float) -> None:
        self._until_s = until_s

    def renew(self, asked_s: float, lease_s: float) -> None:
        """It was asked for at `asked_s`, and the server gave it."""
        self._until_s = max(self._until_s, asked_s + lease_s - MARGIN_S)

    def is_over(self) -> bool:
        """Whether another runner may soon have it."""
        return now_s() > self._until_s

    def write_down(self, folder: Path) -> None:
        """Note it in a run's folder."""
        write_over(folder / HELD, str(self._until_s))

    def note_again(self, folder: Path) -> None:
        """Note it where it was noted: a folder that is just being removed must not get it back.

        Raises:
            OSError: it was not, or cannot be.
        """
        write_over(folder / HELD, str(self._until_s), makes=False)
