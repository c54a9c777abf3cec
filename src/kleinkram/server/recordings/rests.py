"""How soon a mission may be derived again: one of ten thousand files changes with each that is read.

Derived each time, which takes half a second, it would be held all the time, and its files would wait to be read.
"""

import datetime
import time
import uuid

# What takes less is derived at once: people look at what they bring.
_LONG_S = 0.1
# So many times as long as it took, for each that rests; a change is seen after so long at the latest.
_TIMES, _MOST_S = 4.0, 30.0


class Rests:
    """Until when each mission rests that took long. One a worker."""

    def __init__(self) -> None:
        self._until: dict[uuid.UUID, float] = {}

    def took(self, mission_id: uuid.UUID, seconds: float) -> None:
        """Note how long it took to derive a mission."""
        now = time.monotonic()
        self._until = {each: until for each, until in self._until.items() if until > now}
        if seconds >= _LONG_S:
            at_rest = len({*self._until, mission_id})
            self._until[mission_id] = now + min(seconds * _TIMES * at_rest, _MOST_S)

    def left(self, mission_id: uuid.UUID) -> datetime.timedelta:
        """Return how long a mission rests from now; nothing or less when it does not."""
        now = time.monotonic()
        return datetime.timedelta(seconds=self._until.get(mission_id, now) - now)
