"""Times as people give them -> integer nanoseconds, exactly."""

from __future__ import annotations

import datetime
import re

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
_MICROSECOND = datetime.timedelta(microseconds=1)
_ISO = re.compile(r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d)(?::(\d\d)(?:\.(\d{1,9}))?)?)?\s?(Z|[+-]\d\d:?\d\d)?", re.ASCII)

Time = int | str | datetime.datetime
"""Nanoseconds since 1970 (UTC), an aware datetime (pandas' too), or ISO 8601 text, which is UTC unless it says."""


def to_ns(time: Time) -> int:
    """Return nanoseconds since 1970.

    Raises:
        ValueError: a datetime without time zone, or a text that is no time.
        TypeError: it is none of the kinds of `Time`.
    """
    if isinstance(time, str):
        return _read(time)
    if isinstance(time, datetime.datetime):
        if time.tzinfo is None:
            raise ValueError(f"{time} has no time zone; give one, such as datetime.timezone.utc")
        beyond = int(getattr(time, "nanosecond", 0))  # pandas' own, which a datetime lacks
        return (time - _EPOCH) // _MICROSECOND * 1000 + beyond
    try:
        return time.__index__()  # numpy's integers, too
    except AttributeError:
        raise TypeError(f"{time!r} is no time: give nanoseconds since 1970, an aware datetime, or ISO text") from None


def _read(text: str) -> int:
    wrong = ValueError(f"{text!r} is no time; write it like 2026-05-01T10:00:00Z")
    if (found := _ISO.fullmatch(text.strip())) is None:
        raise wrong
    try:
        day, minute, second, fraction, zone = found.groups()
        offset = "+00:00" if zone in (None, "Z") else zone if ":" in zone else f"{zone[:3]}:{zone[3:]}"
        at = datetime.datetime.fromisoformat(f"{day}T{minute or '00:00'}:{second or '00'}{offset}")
    except ValueError:
        raise wrong from None
    return (at - _EPOCH) // _MICROSECOND * 1000 + int((fraction or "0").ljust(9, "0"))
