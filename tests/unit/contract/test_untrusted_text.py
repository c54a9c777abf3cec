"""Names and times in requests without credentials are restricted."""

import datetime

import pytest

from kleinkram.contract.accounts import DeviceBegin
from kleinkram.contract.base import check_expiry


@pytest.mark.parametrize("name", ["", " ", "a\nb", "a\x1b[31m", "a\x9b31m", "klein\u202enimda", "a\u200b", "x" * 101])
def test_a_program_calls_itself_nothing_that_reads_as_something_else(name: str) -> None:
    with pytest.raises(ValueError, match="client"):
        DeviceBegin(client=name)


def test_a_program_is_named_as_it_says() -> None:
    assert DeviceBegin(client="klein on día-3").client == "klein on día-3"


@pytest.mark.parametrize("text", ["0001-01-01T00:00:00+23:59", "9999-12-31T23:59:59-23:59"])
def test_a_time_that_no_clock_in_utc_shows_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"passed already|beyond the year"):
        check_expiry(datetime.datetime.fromisoformat(text))
