"""Times within a recording, as people write them, and ranges of them: [start, end)."""

from __future__ import annotations

import datetime
import re
from decimal import Decimal

from kleinkram.recordings.messages import END_OF_TIME_NS, Time, to_ns

_SECOND_NS = 10**9
_DAY_NS = 86_400 * _SECOND_NS
_UNITS_NS = {
    "h": 3600 * _SECOND_NS,
    "min": 60 * _SECOND_NS,
    "m": 60 * _SECOND_NS,
    "s": _SECOND_NS,
    "ms": 10**6,
    "us": 10**3,
    "ns": 1,
}
_UNIT = "h|min|ms|m|s|us|ns"
_AFTER_START = re.compile(rf"\+(?:\d+(?:\.\d+)?|(?:\d+(?:\.\d+)?\s?(?:{_UNIT})\s?)+)", re.ASCII)
_PART = re.compile(rf"(\d+(?:\.\d+)?)\s?({_UNIT})?", re.ASCII)
_CLOCK = re.compile(r"(\d{1,2}):(\d\d)(?::(\d\d)(?:\.(\d{1,9}))?)?\s?(?:Z|([+-])(\d\d):?(\d\d))?", re.ASCII)
_NANOSECONDS = re.compile(r"\d{16,20}", re.ASCII)
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)


def resolve_range(start: Time | None, end: Time | None, first_ns: int | None, last_ns: int | None) -> tuple[int, int]:
    """Return the log times of a range; None: from the start, or to the end. The other arguments: as `resolve_time`."""
    start_ns = 0 if start is None else resolve_time(start, first_ns, last_ns)
    return start_ns, END_OF_TIME_NS if end is None else resolve_time(end, first_ns, last_ns)


def resolve_time(time: Time, first_ns: int | None, last_ns: int | None) -> int:
    """Return a time in a recording as nanoseconds since 1970.

    A text may also be `10:00` or `10:00:05.5`, a time of day in UTC (or with a zone, `10:00+02:00`) on the day of the
    recording; `+20s`, `+1m30s` or `+20` (seconds) after its start; or 16 to 20 digits, which are nanoseconds.

    Args:
        time: as `to_ns`, or such a text.
        first_ns: earliest log time of the recording; None: unknown.
        last_ns: latest log time of the recording; None: unknown.

    Raises:
        ValueError: the text is not a time, or refers to a recording whose start is unknown.
        TypeError: it is not a `Time`.
    """
    if not isinstance(time, str):
        return to_ns(time)
    text = time.strip()
    if _NANOSECONDS.fullmatch(text):
        return int(text)
    clock, is_offset = _CLOCK.fullmatch(text), _AFTER_START.fullmatch(text)
    if clock is None and is_offset is None:
        try:
            return to_ns(text)
        except ValueError:
            examples = "2026-05-01T10:00:00Z, 10:00 (UTC) or +20s (after the start)"
            raise ValueError(f"{time!r} is no time; write it like {examples}") from None
    if first_ns is None:
        raise ValueError(f"{time!r} depends on when the recording starts, which is unknown; give date and time")
    if clock is not None:
        return _on_its_day(clock, time, first_ns, first_ns if last_ns is None else last_ns)
    parts = _PART.findall(text[1:])
    return first_ns + sum(int(Decimal(number) * _UNITS_NS[unit or "s"]) for number, unit in parts)


def _on_its_day(clock: re.Match[str], text: str, first_ns: int, last_ns: int) -> int:
    """Return a time of day on the day on which a recording starts, or on the next one if that is nearer to it."""
    hour, minute, second, fraction, sign, zone_hours, zone_minutes = clock.groups()
    is_zone = int(zone_hours or 0) < 24 and int(zone_minutes or 0) < 60
    if int(hour) > 23 or int(minute) > 59 or int(second or 0) > 59 or not is_zone:
        raise ValueError(f"{text!r} is no time of day")
    zone_ns = (int(zone_hours or 0) * 60 + int(zone_minutes or 0)) * _UNITS_NS["min"] * (-1 if sign == "-" else 1)
    after_midnight_ns = (int(hour) * 3600 + int(minute) * 60 + int(second or 0)) * _SECOND_NS
    after_midnight_ns += int((fraction or "0").ljust(9, "0"))
    at = (first_ns + zone_ns) // _DAY_NS * _DAY_NS - zone_ns + after_midnight_ns
    next_day = at + _DAY_NS
    return next_day if at < first_ns and next_day - last_ns < first_ns - at else at


def utc_text(time_ns: int) -> str:
    """Return a log time in UTC as ISO 8601 text, to the millisecond; one that no calendar has, in nanoseconds."""
    try:
        at = _EPOCH + datetime.timedelta(seconds=time_ns // _SECOND_NS)
    except OverflowError:
        return f"{time_ns} ns"
    return f"{at:%Y-%m-%dT%H:%M:%S}.{time_ns % _SECOND_NS // 10**6:03d}Z"
