"""Names and times in requests without credentials are restricted."""

import datetime

import pytest

from kleinkram.contract.accounts import DeviceBegin
from kleinkram.contract.base import check_expiry


@pytest.mark.parametrize("name", ["", " ", "a\nb", "a\x1b[31m", "a\x9b31m", "klein\u202enimda", "a\u200b", "x" * 101])
def test_misleading_client_names_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="client"):
        DeviceBegin(client=name)


def test_valid_client_names_are_unchanged() -> None:
    assert DeviceBegin(client="klein on día-3").client == "klein on día-3"


@pytest.mark.parametrize("text", ["0001-01-01T00:00:00+23:59", "9999-12-31T23:59:59-23:59"])
def test_times_out_of_range_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"passed already|beyond the year"):
        check_expiry(datetime.datetime.fromisoformat(text))
