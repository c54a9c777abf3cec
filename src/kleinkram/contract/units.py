"""Sizes, durations and times: reading them from text and writing them as text; only `format_size` rounds."""

import datetime
import math
import re
from collections.abc import Mapping
from fractions import Fraction

MAX_INTEGER = 2**63 - 1
_NUMBER = re.compile(r"(?P<number>\d{1,20}(?:\.\d{1,20})?)\s*(?P<unit>[A-Za-z]*)", re.ASCII)
_LETTERS = "kmgt"
SIZES: Mapping[str, int] = {
    "TB": 1000**4,
    "GB": 1000**3,
    "MB": 1000**2,
    "kB": 1000,
    "TiB": 1024**4,
    "GiB": 1024**3,
    "MiB": 1024**2,
    "KiB": 1024,
    "B": 1,
}
DURATIONS: Mapping[str, int] = {
    "d": 86_400 * 10**9,
    "h": 3_600 * 10**9,
    "m": 60 * 10**9,
    "s": 10**9,
    "ms": 10**6,
    "us": 10**3,
    "ns": 1,
}
_UTC = datetime.timezone.utc
_DATE = re.compile(r"(?P<year>\d{4})(?:-(?P<month>\d{2})(?:-(?P<day>\d{2}))?)?", re.ASCII)
_MONTH = re.compile(r"[12]\d{3}-(0[1-9]|1[0-2])", re.ASCII)
_ZONE = re.compile(r"[-+]\d{2}(:?\d{2})?$")


def read_size(text: str) -> Fraction:
    """Return the bytes of `200MB`, `8MiB`, `1.5G`, `1500`; units without `i` are decimal. Raises ValueError."""
    match = _NUMBER.fullmatch(text.strip())
    unit = match["unit"].lower() if match else ""
    stem = unit.removesuffix("b")
    base = 1024 if stem.endswith("i") else 1000
    letter = stem.removesuffix("i")
    if match is None or (letter and letter not in _LETTERS) or len(letter) > 1 or stem == "i":
        raise ValueError("write bytes, or a number with kB, MB, GB, TB or KiB, MiB, GiB, TiB")
    power: int = base ** (_LETTERS.index(letter) + 1) if letter else 1
    return Fraction(match["number"]) * power


def format_size(size_bytes: float) -> str:
    """Return bytes as a person reads them: `12 B`, `1.5 GB`."""
    for unit in ("B", "kB", "MB", "GB"):
        if size_bytes < 1000:
            return f"{size_bytes:.0f} {unit}" if unit == "B" else f"{size_bytes:.1f} {unit}"
        size_bytes /= 1000
    return f"{size_bytes:.1f} TB"


def read_duration(text: str) -> Fraction:
    """Return the nanoseconds of `10m`, `1.5h`, `200ms`. Raises ValueError."""
    match = _NUMBER.fullmatch(text.strip())
    if match is None or match["unit"] not in DURATIONS:
        raise ValueError("write a number with d, h, m, s, ms, us or ns")
    return Fraction(match["number"]) * DURATIONS[match["unit"]]


def bounds(operator: str, amount: Fraction) -> tuple[int | None, int | None]:
    """Return the smallest and largest integer that satisfy a comparison with `amount`.

    Raises ValueError.
    """
    lowest, highest = math.ceil(amount), math.floor(amount)
    minimum = {">": highest + 1, ">=": lowest, ":": lowest, "=": lowest}.get(operator)
    maximum = {"<": lowest - 1, "<=": highest, ":": highest, "=": highest}.get(operator)
    if maximum is not None and maximum < 0:
        raise ValueError("nothing is smaller than 0")
    if (minimum or 0) > MAX_INTEGER or (maximum or 0) > MAX_INTEGER:
        raise ValueError("the number is too large")
    return minimum, maximum


def format_bound(operator: str, number: int, units: Mapping[str, int]) -> str:
    """Return `>=NUMBER`, `<=NUMBER` or `:NUMBER` with a unit, or the equivalent `>` or `<` if shorter."""
    if operator == ":":
        return operator + _format(number, units)
    other = (">", number - 1) if operator == ">=" else ("<", number + 1)
    here, beside = operator + _format(number, units), other[0] + _format(other[1], units)
    return beside if other[1] >= 0 and len(beside) < len(here) else here


def read_time(text: str) -> datetime.datetime:
    """Return the time of `2026`, `2026-05`, `2026-05-01` (their beginning) or `2026-05-01T10:00Z`; UTC without zone.

    Raises ValueError.
    """
    text = text.strip()
    try:
        if date := _DATE.fullmatch(text):
            return datetime.datetime(int(date["year"]), int(date["month"] or 1), int(date["day"] or 1), tzinfo=_UTC)
        text = text[:-1] + "+00:00" if text[-1:] in {"Z", "z"} else text
        if (zone := _ZONE.search(text)) and len(zone[0]) < len("+00:00"):
            hours, minutes = zone[0][:3], zone[0][3:].lstrip(":") or "00"
            text = f"{text[: zone.start()]}{hours}:{minutes}"
        at = datetime.datetime.fromisoformat(text)
        return at.astimezone(_UTC) if at.tzinfo else at.replace(tzinfo=_UTC)
    except (ValueError, OverflowError):
        raise ValueError("write a time as 2026, 2026-05, 2026-05-01 or 2026-05-01T10:00Z") from None


def format_time(at: datetime.datetime) -> str:
    """Return a time for `read_time`; without a zone it is UTC."""
    try:
        moment = at.astimezone(_UTC) if at.tzinfo else at.replace(tzinfo=_UTC)
    except OverflowError:  # within a day of the year 1 or 9999, where no recording is
        moment = at.replace(tzinfo=_UTC)
    if moment.time() == datetime.time():
        return moment.date().isoformat()
    return moment.replace(tzinfo=None).isoformat() + "Z"


def read_month(text: str) -> str:
    """Return a month such as `2026-05`. Raises ValueError."""
    if _MONTH.fullmatch(text) is None:
        raise ValueError("write a month as 2026-05")
    return text


def _format(number: int, units: Mapping[str, int]) -> str:
    *_, smallest = units
    if number == 0:
        return f"0{smallest}"
    return min((f"{number // size}{unit}" for unit, size in units.items() if number % size == 0), key=len)
