"""Outcomes of checks: rows, their order and number, and quantities as text."""

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import NamedTuple, Protocol

from kleinkram.checks.globs import TooManyComparisons
from kleinkram.contract.base import construct
from kleinkram.contract.checks import MAX_CHECKS, WORST_FIRST, Check, CheckSeverity, CheckStatus
from kleinkram.contract.names import check_file_path
from kleinkram.recordings.model import span_text

_MAX_MESSAGE, _MAX_TOPIC = 2000, 1024
_MAX_TIME_NS = 2**63
_SEVERITIES = {CheckSeverity.warning: CheckStatus.warning, CheckSeverity.error: CheckStatus.error}


ShowProgress = Callable[[float, str], None]
"""Called with the part that is done, from 0 to 1, and the file or recording that comes next."""


def show_nothing(_fraction: float, _name: str) -> None:
    """Show no progress."""


def failed(severity: CheckSeverity) -> CheckStatus:
    """Return the status of a check that fails under a rule of this severity."""
    return _SEVERITIES[severity]


class Measured(NamedTuple):
    """What was measured and the bound that it is compared with, in one unit; finite numbers."""

    value: float
    limit: float | None = None
    unit: str | None = None


_NOTHING: tuple[float | None, float | None, str | None] = (None, None, None)


def make_check(
    name: str,
    status: CheckStatus,
    message: str,
    *,
    topic: str | None = None,
    file: str | None = None,
    time_ns: int | None = None,
    measured: Measured | None = None,
) -> Check:
    """Return the outcome of one check; names and messages from untrusted files are cut and cleaned.

    `file` is left out if it is no path of a file, such as the recording "." of the top folder.
    """
    value, limit, unit = measured or _NOTHING
    values = {
        "name": name,
        "status": status,
        "message": _cut(storable(message), _MAX_MESSAGE) or "no reason is known",
        "value": None if value is None else float(value),
        "limit": None if limit is None else float(limit),
        "unit": unit,
        "topic": _cut(storable(topic), _MAX_TOPIC) or None if topic is not None else None,
        "file": _file(file),
        "time_ns": time_ns if time_ns is not None and 0 <= time_ns < _MAX_TIME_NS else None,
    }
    return construct(Check, values)


LEFT_OUT = "checks.left_out"
"""Name of the row that says how many checks are not listed."""


MAX_MADE = 5 * MAX_CHECKS
"""Of one mission: a thousand rules for `*` ask for two million checks of 2,000 topics. So many take 0.4 s."""


class CollectedChecks(NamedTuple):
    """Checks, worst first, at most `MAX_CHECKS`; `counts` also has those that are not listed."""

    checks: list[Check]
    counts: dict[CheckStatus, int]


def collect(checks: Iterable[Check], *, limit: int = MAX_CHECKS) -> CollectedChecks:
    """Return checks worst first, each once, in their order within a status; holds `limit` of each status at most.

    Of more than `limit`, the last row says how many are left out: not made if checks that failed are among them.
    After `MAX_MADE`, or too many comparisons, no more are made, and a row says so.
    """
    by_status: dict[CheckStatus, dict[Check, None]] = {status: {} for status in WORST_FIRST}
    counts = dict.fromkeys(WORST_FIRST, 0)
    for check in _up_to_limit(checks):
        listed = by_status[check.status]
        number = len(listed)
        listed[check] = None
        if len(listed) > number:
            counts[check.status] += 1
        if len(listed) > limit:
            listed.popitem()
    ordered = [check for status in WORST_FIRST for check in by_status[status]]
    total = sum(counts.values())
    if total > limit:
        ordered = ordered[: limit - 1]
        has_failed = ordered[-1].status in (CheckStatus.error, CheckStatus.warning, CheckStatus.not_made)
        status = CheckStatus.not_made if has_failed else CheckStatus.ok
        ordered.append(make_check(LEFT_OUT, status, f"{total - limit + 1} more checks are not listed"))
        counts[status] += 1
    return CollectedChecks(ordered, counts)


def _up_to_limit(checks: Iterable[Check]) -> Iterator[Check]:
    try:
        for number, check in enumerate(checks):
            if number == MAX_MADE:
                message = f"the rules ask for more than {MAX_MADE:,} checks of this mission; the others were not made"
                yield make_check(LEFT_OUT, CheckStatus.not_made, message)
                return
            yield check
    except TooManyComparisons as error:
        yield make_check(LEFT_OUT, CheckStatus.not_made, str(error))


def storable(text: str) -> str:
    """Return a text without NUL and surrogates, which are written as escapes."""
    if text.isprintable():  # the usual case, which must be fast
        return text
    return text.encode("utf-8", "backslashreplace").decode("utf-8").replace("\x00", "\\0")


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1]}…"


@lru_cache(maxsize=1024)
def _file(path: str | None) -> str | None:
    if path is None:
        return None
    try:
        return check_file_path(path)
    except ValueError:
        return None


def seconds(span_ns: float, digits: int = 4) -> str:
    """Return a span as text with the unit that suits it: µs, ms, s, minutes, days or years."""
    size = abs(span_ns)
    if 0 < size < 1e6:
        return f"{span_ns / 1e3:.{digits}g} µs"
    if 0 < size < 1e9:
        return f"{span_ns / 1e6:.{digits}g} ms"
    if size < 120e9 or digits > 4:
        return f"{span_ns / 1e9:.{digits}g} s"
    if size < 100 * 3600e9:
        minutes, rest = divmod(round(size / 1e9), 60)
        return f"{'-' if span_ns < 0 else ''}{minutes} min {rest:02d} s"
    return span_text(int(span_ns))


def hertz(rate_hz: float, digits: int = 4) -> str:
    """Return a rate as text."""
    return f"{rate_hz:.{digits}g} Hz"


def size(size_bytes: float, digits: int = 3) -> str:
    """Return bytes as text with the unit that suits them."""
    for unit, factor in (("B", 1), ("kB", 10**3), ("MB", 10**6), ("GB", 10**9)):
        if size_bytes < 999.5 * factor:
            return f"{size_bytes / factor:.{digits}g} {unit}"
    return f"{size_bytes / 10**12:.{max(digits, 6)}g} TB"


def percent(share: float, digits: int = 3) -> str:
    """Return a share from 0 to 1 as a percentage."""
    return f"{share * 100:.{digits}g}%"


class FormatQuantity(Protocol):
    """Writes a number as text with about so many digits."""

    def __call__(self, value: float, /, digits: int = ...) -> str:
        """Return the text."""


def against(value: float, limit: float, text_of: FormatQuantity) -> tuple[str, str]:
    """Return value and limit as texts, with as many digits as it takes to see which is greater."""
    texts = text_of(value), text_of(limit)
    digits = 5
    while texts[0] == texts[1] and value != limit and digits < 20:
        texts = text_of(value, digits), text_of(limit, digits)
        digits += 1
    return texts
