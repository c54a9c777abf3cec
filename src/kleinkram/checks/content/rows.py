"""Makes rows of checks from what was found in untrusted recordings: texts are shortened and made storable."""

import math
from contextlib import suppress

from kleinkram.contract.checks import Check, CheckSeverity, CheckStatus
from kleinkram.contract.names import check_file_path

_MAX_MESSAGE, _MAX_TOPIC, _MAX_TIME_NS = 2000, 1024, 2**63 - 1


def make_row(
    name: str,
    status: CheckStatus,
    message: str,
    *,
    topic: str | None = None,
    file: str | None = None,
    value: float | None = None,
    limit: float | None = None,
    unit: str | None = None,
    time_ns: int | None = None,
) -> Check:
    """Return the row of a check; `value` is left out if it is not finite, and names that cannot be stored are."""
    return Check(
        name=name,
        status=status,
        message=_shortened(_storable(message), _MAX_MESSAGE) or "no message",
        value=value if value is not None and math.isfinite(value) else None,
        limit=limit,
        unit=unit,
        topic=_shortened(_storable(topic), _MAX_TOPIC) or None if topic else None,
        file=_path(file),
        time_ns=time_ns if time_ns is not None and 0 <= time_ns <= _MAX_TIME_NS else None,
    )


def status_of(severity: CheckSeverity) -> CheckStatus:
    """Return the status of a check that fails."""
    return CheckStatus(severity.value)


def seconds(duration_ns: float) -> str:
    """Return a duration as text, such as "12.5 ms"."""
    size = abs(duration_ns)
    for unit, factor in (("s", 1e9), ("ms", 1e6), ("µs", 1e3)):
        if size >= factor:
            return f"{duration_ns / factor:.4g} {unit}"
    return f"{duration_ns:.4g} ns"


def number(value: float) -> str:
    """Return a number as text, with at most four digits."""
    return f"{value:.4g}"


def _storable(text: str) -> str:
    return "".join("\ufffd" if sign == "\x00" or "\ud800" <= sign <= "\udfff" else sign for sign in text)


def _shortened(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1]}…"


def _path(file: str | None) -> str | None:
    if file:
        with suppress(ValueError):
            return check_file_path(file)
    return None
