"""Dates and times as text or nanoseconds, in a form that compares in order."""

import datetime
import re

_MIN_NS, _MAX_NS = -(2**63), 2**63 - 1
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
_ISO_DATE = re.compile(r"\d{4}-\d{2}-\d{2}", re.ASCII)
_TIME = re.compile(
    r"(?P<day>\d{4}-\d{2}-\d{2})[Tt ](?P<clock>\d{2}:\d{2}(:\d{2})?)(\.(?P<fraction>\d{1,6}))?"
    r" ?(?P<zone>[Zz]|[-+]\d{2}(:?\d{2})?)?",
    re.ASCII,
)


def iso_text(text: str) -> str | None:
    """Return an ISO date as it is and a date with time in UTC, so that text compares as time; None if it is neither.

    A time without zone is taken as UTC. Source: ISO 8601-1:2019, extended format.
    """
    try:
        if _ISO_DATE.fullmatch(text):
            return datetime.date.fromisoformat(text).isoformat()
        if match := _TIME.fullmatch(text):
            return _in_utc(match).isoformat()
    except (ValueError, OverflowError):  # the 30th of February; a zone that leaves the year 9999
        return None
    return None


def _in_utc(match: re.Match[str]) -> datetime.datetime:
    clock = match["clock"] if match.group(3) else match["clock"] + ":00"
    zone = (match["zone"] or "Z").upper().replace("Z", "+00:00")
    if len(zone) == 3:
        zone += ":00"
    if ":" not in zone:
        zone = f"{zone[:3]}:{zone[3:]}"
    fraction = (match["fraction"] or "").ljust(6, "0")
    parsed = datetime.datetime.fromisoformat(f"{match['day']}T{clock}.{fraction}{zone}")
    return parsed.astimezone(datetime.timezone.utc)


def nanoseconds(at: datetime.datetime) -> int:
    """Return a time as nanoseconds since 1970 UTC, limited to the range of a bigint; without zone it is UTC."""
    aware = at if at.tzinfo else at.replace(tzinfo=datetime.timezone.utc)
    microseconds = (aware - _EPOCH) // datetime.timedelta(microseconds=1)
    return min(max(microseconds * 1000, _MIN_NS), _MAX_NS)
