"""Sizes, rates, durations and times: reading them from options and formatting them for people."""

import datetime
from collections.abc import Callable

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.units import format_size, read_size, read_time

_NS = 1_000_000_000
_YEAR_S = 365.25 * 86_400


def count(number: int, noun: str, plural: str = "") -> str:
    """Return `1 file`, `2 files`; `plural` where it is not the noun with an s."""
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def parse_size(text: str) -> int:
    """Return the bytes of `200MB`, `10M`, `8MiB`, `1500`; units are decimal unless they contain an `i`."""
    try:
        return int(read_size(text.strip().removesuffix("/s")))
    except ValueError as error:
        raise InvalidInput(what=f"The size {text!r}", reason=str(error)) from None


def parse_rate(text: str | None) -> float | None:
    """Return the bytes per second of `10M`; None for no limit."""
    if text is None:
        return None
    rate = parse_size(text)
    if rate <= 0:
        raise InvalidInput(what="The rate", reason="it must be above zero")
    return float(rate)


def parse_time(text: str | None) -> datetime.datetime | None:
    """Return the time of `2026-05-01` or `2026-05-01T10:00:00+02:00`; UTC where no zone is given."""
    try:
        return None if text is None else read_time(text)
    except ValueError as error:
        raise InvalidInput(what=f"The time {text!r}", reason=str(error)) from None


def expiry(until: str | None, days: int | None, now: Callable[[], datetime.datetime]) -> datetime.datetime | None:
    """Return the end that `--until` or `--days` names, or None. `now` is the clock of the server, which counts days."""
    if until is not None and days is not None:
        raise InvalidInput(what="The command", reason="specify --until or --days, not both")
    return parse_time(until) if days is None else now() + datetime.timedelta(days=days)


def size(size_bytes: int | None) -> str | None:
    """Return bytes as a person reads them."""
    return None if size_bytes is None else format_size(size_bytes)


def duration(nanoseconds: int | None) -> str | None:
    """Return a span as a person reads it."""
    if nanoseconds is None:
        return None
    seconds = nanoseconds / _NS
    if seconds < 60:
        if nanoseconds == 0:
            return "0 s"
        return f"{seconds:.3f} s" if seconds < 10 else f"{seconds:.1f} s"
    if seconds >= _YEAR_S:
        return f"{seconds / _YEAR_S:.1f} years"
    if seconds >= 100 * 3600:
        return f"{seconds / 86_400:.1f} days"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


def total_hours(nanoseconds: int | None) -> str | None:
    """Return a sum of recorded time as a person reads it: in hours where it is long."""
    if nanoseconds is None or nanoseconds < 100 * 3600 * _NS:
        return duration(nanoseconds)
    return f"{round(nanoseconds / (3600 * _NS)):,} h"


def instant(nanoseconds: int | None) -> str | None:
    """Return a log time (nanoseconds since 1970) in UTC, to the millisecond."""
    if nanoseconds is None:
        return None
    try:
        at = datetime.datetime.fromtimestamp(nanoseconds // _NS, datetime.timezone.utc)
    except (ValueError, OverflowError, OSError):
        return f"{nanoseconds} ns"
    return f"{at:%Y-%m-%dT%H:%M:%S}.{nanoseconds % _NS // 1_000_000:03d}Z"


def span(start_ns: int | None, end_ns: int | None) -> str | None:
    """Return the time from start to end."""
    return None if start_ns is None or end_ns is None else duration(end_ns - start_ns)


def rate(hertz: float | None) -> str | None:
    """Return a rate as a person reads it."""
    return None if hertz is None else f"{hertz:.2f} Hz"
