"""What this process hears of changes and passes on to its streams: by one connection, however many streams there are.

Holds some thousand notices in memory, and no database connection for a stream. Decides nothing about rights.
"""

import asyncio
import logging
import secrets
import uuid
from collections import Counter, deque
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass

import psycopg
from psycopg.conninfo import make_conninfo

from kleinkram.contract.errors import TooManyStreams
from kleinkram.server.change_events import CHANNEL, EVERYTHING, ChangeEvent, read_event
from kleinkram.server.settings import Settings, plain_dsn

_log = logging.getLogger("kleinkram.events")
MOST_STREAMS = 16
_MOST_STREAMS_OF_ALL = 1000
# Requests that wait for something to happen (long polls): of one account or runner, and of all together.
MOST_LONG_POLLS = 32
_MOST_LONG_POLLS_OF_ALL = 1000
MOST_WAITING = 500
# What a client that comes back after a moment is told of the time between.
_REMEMBERED = 2000
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 5.0
# A peer that is gone without a word is noticed after 30 s; what it would have told was missed.
_WAITING: dict[str, str | int] = {
    "application_name": "kleinkram events",
    "connect_timeout": 5,
    "keepalives_idle": 15,
    "keepalives_interval": 5,
    "keepalives_count": 3,
}


@dataclass(frozen=True)
class Heard:
    """What a stream has to tell: notices, or that there were more than it could wait with. `until` is its place."""

    notices: list[ChangeEvent]
    until: str
    was_too_much: bool
    was_missed: bool


@dataclass(frozen=True)
class Topic:
    """Which changes wake a listener: those of these nouns and, with `noun_id`, of this one or of several at once."""

    nouns: frozenset[str]
    noun_id: uuid.UUID | None = None

    def includes(self, notice: ChangeEvent) -> bool:
        """Whether the listener is to be woken by this change."""
        return notice.noun in self.nouns and (None in (self.noun_id, notice.id) or notice.id == self.noun_id)


class Listener:
    """What one stream or long poll has heard and not told yet; bounded."""

    def __init__(self, topic: Topic | None = None) -> None:
        self._topic = topic
        self._waiting: dict[ChangeEvent, None] = {}
        self._was_too_much = False
        self._was_missed = False
        self._woken = asyncio.Event()

    def hear(self, notice: ChangeEvent) -> None:
        """Keep a notice until it is told; the same one again changes nothing."""
        if self._topic is not None and not self._topic.includes(notice):
            return
        if not self._was_too_much and not self._was_missed:
            self._waiting[notice] = None
            if len(self._waiting) > MOST_WAITING:
                self._waiting.clear()
                self._was_too_much = True
        self._woken.set()

    def miss(self) -> None:
        """Note that something may have happened which nobody can tell any more."""
        self._waiting.clear()
        self._was_missed = True
        self._woken.set()

    def wake(self) -> None:
        """End its waiting."""
        self._woken.set()

    def take(self, until: str) -> Heard:
        """Return what waits, and wait for more."""
        heard = Heard(list(self._waiting), until, self._was_too_much, self._was_missed)
        self._waiting.clear()
        self._was_too_much = self._was_missed = False
        self._woken.clear()
        return heard

    async def wait(self, at_most_s: float) -> None:
        """Wait until there is something to tell."""
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._woken.wait(), at_most_s)


class Hub:
    """All streams of this process."""

    def __init__(self) -> None:
        self._listeners: dict[Listener, uuid.UUID | None] = {}
        self._long_polls: dict[Listener, uuid.UUID | None] = {}
        self._remembered: deque[ChangeEvent] = deque(maxlen=_REMEMBERED)
        self._count = 0
        self._era = secrets.token_hex(4)
        self._over = asyncio.Event()
        # So that streams that look whether they may tell something leave connections to everybody else.
        self.looking = asyncio.Semaphore(2)

    @property
    def is_over(self) -> bool:
        """Whether all streams are to end."""
        return self._over.is_set()

    @property
    def place(self) -> str:
        """The id of the last event: a client that comes back with it is told what came after."""
        return f"{self._era}-{self._count}"

    def see_that_one_more_may(self, person_id: uuid.UUID | None) -> None:
        """See that somebody may open one more stream.

        Raises:
            TooManyStreams: they have as many as one person gets of a process, or all have.
        """
        own = Counter(self._listeners.values())[person_id]
        if own >= MOST_STREAMS or len(self._listeners) >= _MOST_STREAMS_OF_ALL:
            raise TooManyStreams(limit=MOST_STREAMS)

    @contextmanager
    def listening(self, person_id: uuid.UUID | None, *, after: str | None) -> Iterator[Listener]:
        """Hear what changes from now on, and what changed since the event `after` where that is still known."""
        listener = Listener()
        if after is not None:
            for notice in self._since(after, listener):
                listener.hear(notice)
        self._listeners[listener] = person_id
        try:
            yield listener
        finally:
            del self._listeners[listener]

    @contextmanager
    def long_poll(self, account_id: uuid.UUID | None, topic: Topic) -> Iterator[Listener]:
        """Hear what changes of a topic from now on, in a request that waits for it.

        Raises:
            TooManyStreams: as many requests wait as one account gets of a process, or as all get together.
        """
        own = Counter(self._long_polls.values())[account_id]
        if own >= MOST_LONG_POLLS or len(self._long_polls) >= _MOST_LONG_POLLS_OF_ALL:
            raise TooManyStreams(limit=MOST_LONG_POLLS)
        listener = Listener(topic)
        self._long_polls[listener] = account_id
        try:
            yield listener
        finally:
            del self._long_polls[listener]

    async def next_change(self, listener: Listener, *, at_most_s: float) -> None:
        """Wait until something of a long poll's topic changed, or may have; until all is over; or until the time is."""
        if not self.is_over:
            await listener.wait(at_most_s)
            listener.take(self.place)

    @property
    def _all_listeners(self) -> list[Listener]:
        return [*self._listeners, *self._long_polls]

    def end(self) -> None:
        """End all streams, soon."""
        self._over.set()
        for listener in self._all_listeners:
            listener.wake()

    async def rest(self, seconds: float) -> None:
        """Let some time pass, unless all is over."""
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._over.wait(), max(0.0, seconds))

    def take_in(self, said: str) -> None:
        """Pass on what PostgreSQL told."""
        if said == EVERYTHING:
            self.begin_anew()
            return
        notice = read_event(said)
        self._count += 1
        self._remembered.append(notice)
        for listener in self._all_listeners:
            listener.hear(notice)

    def begin_anew(self) -> None:
        """Note that something may have been missed: nobody is told of the time before."""
        self._era = secrets.token_hex(4)
        self._remembered.clear()
        for listener in self._all_listeners:
            listener.miss()

    def _since(self, after: str, listener: Listener) -> list[ChangeEvent]:
        era, _, number = after.partition("-")
        behind = self._count - int(number) if era == self._era and number.isdecimal() else -1
        if 0 <= behind <= len(self._remembered):
            return list(self._remembered)[len(self._remembered) - behind :]
        listener.miss()
        return []


@asynccontextmanager
async def open_hub(settings: Settings) -> AsyncIterator[Hub]:
    """Listen for as long as a process serves."""
    hub = Hub()
    dsn = make_conninfo(plain_dsn(settings.database_url), **_WAITING)
    task = asyncio.create_task(_keep_hearing(hub, dsn))
    try:
        yield hub
    finally:
        hub.end()
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def _keep_hearing(hub: Hub, dsn: str) -> None:
    pause_s = _FIRST_PAUSE_S
    while True:
        try:
            async with await psycopg.AsyncConnection.connect(dsn, autocommit=True) as connection:
                await connection.execute(f"LISTEN {CHANNEL}")
                hub.begin_anew()
                pause_s = _FIRST_PAUSE_S
                async for notify in connection.notifies():
                    hub.take_in(notify.payload)
        except psycopg.Error as error:
            _log.warning("changes not heard", extra={"fields": {"reason": type(error).__name__, "pause_s": pause_s}})
        await asyncio.sleep(pause_s)
        pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
