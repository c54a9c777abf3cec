"""Times in the one form in which they are stored and compared."""

import datetime

import pytest

from kleinkram.server.filters.dates import iso_text, nanoseconds


@pytest.mark.parametrize(
    ("text", "stored"),
    [
        ("2024-05-31", "2024-05-31"),
        ("2024-05-31T14:00", "2024-05-31T14:00:00+00:00"),
        ("2024-05-31 14:00:01", "2024-05-31T14:00:01+00:00"),
        ("2024-05-31t14:00:01.5z", "2024-05-31T14:00:01.500000+00:00"),
        ("2024-05-31T00:30:00+02:00", "2024-05-30T22:30:00+00:00"),
        ("2024-05-31T00:30-0130", "2024-05-31T02:00:00+00:00"),
        ("2024-05-31T00:30 +02", "2024-05-30T22:30:00+00:00"),
        ("2024-02-30", None),
        ("2024-05-31T25:00", None),
        ("9999-12-31T23:00-05:00", None),
        ("31.5.2024", None),
        ("20240531", None),
        ("2024", None),
        ("٢٠٢٤-٠٥-٣١", None),
        ("2024-05-31\n", None),
    ],
)
def test_iso_text(text: str, stored: str | None) -> None:
    assert iso_text(text) == stored


def test_nanoseconds_are_exact_and_within_a_bigint() -> None:
    at = datetime.datetime(2024, 5, 31, 12, 0, 0, 123_457, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))
    assert nanoseconds(at) == 1_717_149_600_123_457_000
    assert nanoseconds(at.replace(tzinfo=None)) == 1_717_156_800_123_457_000
    assert nanoseconds(datetime.datetime.max) == 2**63 - 1
    assert nanoseconds(datetime.datetime.min) == -(2**63)
