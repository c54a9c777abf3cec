"""Times as people write them, resolved within a recording."""

from __future__ import annotations

import datetime

import pytest

from kleinkram.recordings.messages import END_OF_TIME_NS, to_ns
from kleinkram.recordings.time_range import resolve_range, resolve_time, utc_text

FIRST, LAST = to_ns("2024-05-01T09:58:00Z"), to_ns("2024-05-01T10:12:00Z")
LATE, EARLY = to_ns("2024-05-01T23:50:00Z"), to_ns("2024-05-02T00:20:00Z")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2024-05-01T10:00:00Z", to_ns("2024-05-01T10:00Z")),
        ("1714557600000000000", 1714557600000000000),
        ("10:00", to_ns("2024-05-01T10:00Z")),
        ("10:00:05.25", to_ns("2024-05-01T10:00:05.25Z")),
        ("10:00Z", to_ns("2024-05-01T10:00Z")),
        ("12:00+02:00", to_ns("2024-05-01T10:00Z")),
        ("02:00 -0800", to_ns("2024-05-01T10:00Z")),
        ("09:57", to_ns("2024-05-01T09:57Z")),
        ("+20s", FIRST + 20 * 10**9),
        ("+20", FIRST + 20 * 10**9),
        ("+1m30s", FIRST + 90 * 10**9),
        ("+1min 30s", FIRST + 90 * 10**9),
        ("+0.1s", FIRST + 10**8),
        ("+1h", FIRST + 3600 * 10**9),
        ("+500ms", FIRST + 5 * 10**8),
    ],
)
def test_texts_are_times_in_the_recording(text: str, expected: int) -> None:
    assert resolve_time(text, FIRST, LAST) == expected


def test_a_time_of_day_is_on_the_day_that_is_nearer() -> None:
    assert resolve_time("23:55", LATE, EARLY) == to_ns("2024-05-01T23:55Z")
    assert resolve_time("00:10", LATE, EARLY) == to_ns("2024-05-02T00:10Z")
    assert resolve_time("00:30", LATE, EARLY) == to_ns("2024-05-02T00:30Z"), "after the end, not a day before"
    assert resolve_time("23:40", LATE, EARLY) == to_ns("2024-05-01T23:40Z")


def test_numbers_and_datetimes_stay_what_they_are() -> None:
    at = datetime.datetime(2024, 5, 1, 10, tzinfo=datetime.timezone.utc)
    assert resolve_time(7, None, None) == 7
    assert resolve_time(at, None, None) == to_ns("2024-05-01T10:00Z")
    assert resolve_range(None, None, None, None) == (0, END_OF_TIME_NS)
    assert resolve_range("+1s", "+2s", FIRST, LAST) == (FIRST + 10**9, FIRST + 2 * 10**9)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "soon",
        "10",
        "1714557600",
        "25:00",
        "10:60",
        "10:00:60",
        "+",
        "+20x",
        "-20s",
        "+s",
        "10:00+24:00",
        "10:00+01:60",
    ],
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="no time"):
        resolve_time(text, FIRST, LAST)


@pytest.mark.parametrize("text", ["10:00", "+20s"])
def test_a_recording_of_unknown_times_has_no_relative_ones(text: str) -> None:
    with pytest.raises(ValueError, match="when the recording starts, which is unknown"):
        resolve_time(text, None, None)


def test_times_are_shown_in_utc() -> None:
    assert utc_text(to_ns("2024-05-01T10:00:00.1239Z")) == "2024-05-01T10:00:00.123Z"
    assert utc_text(END_OF_TIME_NS * 1000) == f"{END_OF_TIME_NS * 1000} ns"
