"""Sizes, rates and times."""

import datetime

import pytest

from kleinkram.cli import units
from kleinkram.client.errors import InvalidInput


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("1500", 1500),
        ("200MB", 200_000_000),
        ("10M", 10_000_000),
        ("1.5k", 1500),
        ("8MiB", 8 * 1024**2),
        ("2 GiB", 2 * 1024**3),
        ("10MB/s", 10_000_000),
        ("0", 0),
    ],
)
def test_sizes_are_read(text: str, size: int) -> None:
    assert units.parse_size(text) == size


@pytest.mark.parametrize("text", ["", "M", "-5", "1e9", "10 apples", "1.2.3"])
def test_invalid_sizes_are_refused(text: str) -> None:
    with pytest.raises(InvalidInput):
        units.parse_size(text)


def test_a_rate_is_above_zero() -> None:
    assert units.parse_rate(None) is None
    assert units.parse_rate("10M") == 10_000_000
    with pytest.raises(InvalidInput):
        units.parse_rate("0")


def test_times_are_utc_unless_they_say_otherwise() -> None:
    utc = datetime.timezone.utc
    assert units.parse_time("2026-05-01") == datetime.datetime(2026, 5, 1, tzinfo=utc)
    assert units.parse_time("2026-05-01T10:00:00Z") == datetime.datetime(2026, 5, 1, 10, tzinfo=utc)
    assert units.parse_time("2026-05-01T10:00:00+02:00") == datetime.datetime(2026, 5, 1, 8, tzinfo=utc)
    with pytest.raises(InvalidInput):
        units.parse_time("yesterday")


@pytest.mark.parametrize(
    ("size", "shown"),
    [(0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (31_000_000, "31.0 MB"), (5 * 10**15, "5000.0 TB")],
)
def test_sizes_are_shown(size: int, shown: str) -> None:
    assert units.size(size) == shown


@pytest.mark.parametrize(
    ("nanoseconds", "shown"),
    [
        (5_000_000, "0.005 s"),
        (12_340_000_000, "12.3 s"),
        (61 * 10**9, "1 min 01 s"),
        (7260 * 10**9, "2 h 01 min"),
        (102_492 * 3600 * 10**9, "11.7 years"),
        (100 * 3600 * 10**9, "4.2 days"),
    ],
)
def test_spans_are_shown(nanoseconds: int, shown: str) -> None:
    assert units.duration(nanoseconds) == shown


def test_instants_are_utc_to_the_millisecond() -> None:
    assert units.instant(1_777_593_600_123_999_999) == "2026-05-01T00:00:00.123Z"
    assert units.instant(10**30) == f"{10**30} ns"
    assert units.instant(None) is None


def test_counts_have_singular_and_plural() -> None:
    assert [units.count(number, "file") for number in (0, 1, 2, 1200)] == [
        "0 files",
        "1 file",
        "2 files",
        "1,200 files",
    ]
    assert [units.count(number, "entry", "entries") for number in (1, 2)] == ["1 entry", "2 entries"]


def test_a_long_sum_of_recorded_time_is_shown_in_hours() -> None:
    assert units.total_hours(1204 * 3600 * 10**9) == "1,204 h"
    assert units.total_hours(7260 * 10**9) == "2 h 01 min"
