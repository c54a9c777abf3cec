"""Times as people give them -> integer nanoseconds, exactly."""

from __future__ import annotations

import datetime

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
_MICROSECOND = datetime.timedelta(microseconds=1)

Time = int | datetime.datetime
"""Nanoseconds since 1970 (UTC), or an aware datetime."""


def to_ns(time: Time) -> int:
    """Return nanoseconds since 1970.

    Raises:
        ValueError: a datetime without time zone.
    """
    if isinstance(time, int):
        return time
    if time.tzinfo is None:
        raise ValueError(f"{time} has no time zone; give one, such as datetime.timezone.utc")
    return (time - _EPOCH) // _MICROSECOND * 1000
