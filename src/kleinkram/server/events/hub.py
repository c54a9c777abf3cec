"""Distributes the changes that PostgreSQL announces (LISTEN) to the streams and long polls of this process.

Uses one database connection for all of them and keeps the last events in memory. Does not check rights.
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

from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.errors import TooManyStreams
from kleinkram.server import metrics
from kleinkram.server.background import cancel_and_wait
from kleinkram.server.change_events import CHANNEL, EVERYTHING, ChangeEvent, read_event
from kleinkram.server.settings import Settings, plain_dsn

_log = logging.getLogger("kleinkram.events")
MAX_STREAMS_PER_PERSON = 16
_MAX_STREAMS = 1000
MAX_LONG_POLLS_PER_ACCOUNT = 32
_MAX_LONG_POLLS = 1000
MAX_PENDING = 500
# Events that are kept for clients that reconnect.
_HISTORY_LENGTH = 2000
_MIN_RECONNECT_S, _MAX_RECONNECT_S = 0.1, 5.0
# With these keepalives, a dead connection is noticed after 30 s.
_CONNECTION: dict[str, str | int] = {
    "application_name": "kleinkram events",
    "connect_timeout": 5,
    "keepalives_idle": 15,
    "keepalives_interval": 5,
    "keepalives_count": 3,
}


@dataclass(frozen=True)
class PendingEvents:
    """The events that a stream has not sent yet; `has_overflowed` if there were too many to keep."""

    events: list[ChangeEvent]
    last_event_id: str
    has_overflowed: bool
    was_missed: bool


@dataclass(frozen=True)
class EventFilter:
    """Events of these types, perhaps of one kind; with `resource_id`, of this object or of several objects at once."""

    resource_types: frozenset[str]
    resource_id: uuid.UUID | None = None
    change: ChangeKind | None = None

    def includes(self, event: ChangeEvent) -> bool:
        """Whether an event passes the filter."""
        if event.resource_type not in self.resource_types or self.change not in (None, event.change):
            return False
        return None in (self.resource_id, event.id) or event.id == self.resource_id


class EventSubscription:
    """The bounded queue of events of one stream or long poll."""

    def __init__(self, event_filter: EventFilter | None = None) -> None:
        self._filter = event_filter
        self._pending: dict[ChangeEvent, None] = {}
        self._has_overflowed = False
        self._was_missed = False
        self._wakeup = asyncio.Event()

    def add(self, event: ChangeEvent) -> None:
        """Add an event that passes the filter; a duplicate is ignored."""
        if self._filter is not None and not self._filter.includes(event):
            return
        if not self._has_overflowed and not self._was_missed:
            self._pending[event] = None
            if len(self._pending) > MAX_PENDING:
                self._pending.clear()
                self._has_overflowed = True
        self._wakeup.set()

    def mark_missed(self) -> None:
        """Record that events may have been missed."""
        self._pending.clear()
        self._was_missed = True
        self._wakeup.set()

    def wake(self) -> None:
        """End `wait`."""
        self._wakeup.set()

    def take(self, last_event_id: str) -> PendingEvents:
        """Return and clear the pending events."""
        pending = PendingEvents(list(self._pending), last_event_id, self._has_overflowed, self._was_missed)
        self._pending.clear()
        self._has_overflowed = self._was_missed = False
        self._wakeup.clear()
        return pending

    async def wait(self, timeout_s: float) -> None:
        """Wait until there are pending events."""
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._wakeup.wait(), timeout_s)


class Hub:
    """All subscriptions of this process."""

    def __init__(self) -> None:
        self._streams: dict[EventSubscription, uuid.UUID | None] = {}
        self._long_polls: dict[EventSubscription, uuid.UUID | None] = {}
        self._history: deque[ChangeEvent] = deque(maxlen=_HISTORY_LENGTH)
        self._count = 0
        self._epoch = secrets.token_hex(4)
        self._closed = asyncio.Event()
        # Limits the database connections that streams use at the same time.
        self.rights_checks = asyncio.Semaphore(2)

    @property
    def is_closed(self) -> bool:
        """Whether all streams must end."""
        return self._closed.is_set()

    @property
    def last_event_id(self) -> str:
        """The id of the last event, with which a client continues."""
        return f"{self._epoch}-{self._count}"

    def require_free_stream(self, person_id: uuid.UUID | None) -> None:
        """Check that a person may open one more stream. Raises TooManyStreams."""
        own = Counter(self._streams.values())[person_id]
        if own >= MAX_STREAMS_PER_PERSON or len(self._streams) >= _MAX_STREAMS:
            raise TooManyStreams(limit=MAX_STREAMS_PER_PERSON)

    @contextmanager
    def subscribe(self, person_id: uuid.UUID | None, *, after: str | None) -> Iterator[EventSubscription]:
        """Subscribe a stream to all events, including those after the event `after` if they are still known."""
        subscription = EventSubscription()
        if after is not None:
            self._replay(after, subscription)
        self._streams[subscription] = person_id
        try:
            with metrics.EVENT_STREAMS.track_inprogress():
                yield subscription
        finally:
            del self._streams[subscription]

    @contextmanager
    def long_poll(self, account_id: uuid.UUID | None, event_filter: EventFilter) -> Iterator[EventSubscription]:
        """Subscribe a request that waits for an event. Raises TooManyStreams."""
        own = Counter(self._long_polls.values())[account_id]
        if own >= MAX_LONG_POLLS_PER_ACCOUNT or len(self._long_polls) >= _MAX_LONG_POLLS:
            raise TooManyStreams(limit=MAX_LONG_POLLS_PER_ACCOUNT)
        subscription = EventSubscription(event_filter)
        self._long_polls[subscription] = account_id
        try:
            with metrics.LONG_POLLS.track_inprogress():
                yield subscription
        finally:
            del self._long_polls[subscription]

    async def next_event(self, subscription: EventSubscription, *, timeout_s: float) -> None:
        """Wait until a long poll has, or may have missed, an event, the hub closes, or the time is over."""
        if not self.is_closed:
            await subscription.wait(timeout_s)
            subscription.take(self.last_event_id)

    @property
    def _subscriptions(self) -> list[EventSubscription]:
        return [*self._streams, *self._long_polls]

    def close(self) -> None:
        """Make all streams end."""
        self._closed.set()
        for subscription in self._subscriptions:
            subscription.wake()

    async def sleep(self, seconds: float) -> None:
        """Wait until the time is over or the hub closes."""
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._closed.wait(), max(0.0, seconds))

    def receive(self, payload: str) -> None:
        """Add an announced event to all subscriptions."""
        if payload == EVERYTHING:
            self.reset()
            return
        event = read_event(payload)
        metrics.EVENTS.inc()
        self._count += 1
        self._history.append(event)
        for subscription in self._subscriptions:
            subscription.add(event)

    def reset(self) -> None:
        """Forget all events, because some may have been missed."""
        self._epoch = secrets.token_hex(4)
        self._history.clear()
        for subscription in self._subscriptions:
            subscription.mark_missed()

    def _replay(self, after: str, subscription: EventSubscription) -> None:
        epoch, _, number = after.partition("-")
        behind = self._count - int(number) if epoch == self._epoch and number.isdecimal() else -1
        if not 0 <= behind <= len(self._history):
            subscription.mark_missed()
            return
        for event in list(self._history)[len(self._history) - behind :]:
            subscription.add(event)


@asynccontextmanager
async def open_hub(settings: Settings) -> AsyncIterator[Hub]:
    """Open the hub of a process and listen for events."""
    hub = Hub()
    dsn = make_conninfo(plain_dsn(settings.database_url), **_CONNECTION)
    task = asyncio.create_task(_listen(hub, dsn))
    try:
        yield hub
    finally:
        hub.close()
        await cancel_and_wait(task)


async def _listen(hub: Hub, dsn: str) -> None:
    pause_s = _MIN_RECONNECT_S
    while True:
        try:
            async with await psycopg.AsyncConnection.connect(dsn, autocommit=True) as connection:
                await connection.execute(f"LISTEN {CHANNEL}")
                hub.reset()
                metrics.EVENT_LISTENER_UP.set(1)
                pause_s = _MIN_RECONNECT_S
                async for notification in connection.notifies():
                    hub.receive(notification.payload)
        except psycopg.Error as error:
            _log.warning(
                "not listening for changes", extra={"fields": {"reason": type(error).__name__, "pause_s": pause_s}}
            )
        metrics.EVENT_LISTENER_UP.set(0)
        await asyncio.sleep(pause_s)
        pause_s = min(2 * pause_s, _MAX_RECONNECT_S)
