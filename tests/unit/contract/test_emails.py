"""Email addresses: valid forms and equality; times of expiry."""

import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from kleinkram.contract.base import Expiry
from kleinkram.contract.people import EmailAddress, EmailDomain, email_domain, email_key

_ADDRESS: TypeAdapter[str] = TypeAdapter(EmailAddress)
_DOMAIN: TypeAdapter[str] = TypeAdapter(EmailDomain)
_EXPIRY: TypeAdapter[datetime.datetime] = TypeAdapter(Expiry)


@pytest.mark.parametrize("address", ["a@b", "Ada.Lovelace+robots@Lab.Example", "o'hara@xn--zrich-kva.example"])
def test_valid_addresses_are_unchanged(address: str) -> None:
    assert _ADDRESS.validate_python(address) == address


@pytest.mark.parametrize(
    "address",
    [
        "",
        "ada",
        "@lab.example",
        "ada@",
        "ada@lab@lab.example",
        ".ada@lab.example",
        "a..b@lab.example",
        "ada@-lab.example",
        "ada@lab..example",
        "ada@lab.example.",
        "ada lovelace@lab.example",
        "ada@lab.example\n",
        '"ada@evil"@lab.example',
        "a\u212ada@lab.example",
        "ada@l\u00e4b.example",
        "\u0131da@lab.example",
        "a" * 250 + "@lab.example",
    ],
)
def test_invalid_and_confusable_addresses_are_refused(address: str) -> None:
    with pytest.raises(ValidationError):
        _ADDRESS.validate_python(address)


@given(st.from_regex(r"[A-Za-z0-9.+-]{1,20}@[A-Za-z0-9.-]{1,20}", fullmatch=True))
def test_email_keys_ignore_case(address: str) -> None:
    assert email_key(address.upper()) == email_key(address.swapcase()) == email_key(address)
    assert email_key(address).endswith("@" + email_domain(address))


@pytest.mark.parametrize("domain", ["@lab.example", "*.lab.example", "lab.example.", "", "l\u00e4b.example", "a b"])
def test_invalid_domains_are_refused(domain: str) -> None:
    with pytest.raises(ValidationError):
        _DOMAIN.validate_python(domain)
    assert _DOMAIN.validate_python("LAB.example") == "lab.example"


def test_expiry_times_require_a_zone_and_are_utc() -> None:
    assert _EXPIRY.validate_python("2027-01-01T00:00:00+02:00").isoformat() == "2026-12-31T22:00:00+00:00"
    for text in (
        "2027-01-01T00:00:00",
        "9999-12-31T23:59:59-12:00",
        "9999-12-31T23:59:59Z",
        "0001-01-01T00:00:00+14:00",
        "soon",
    ):
        with pytest.raises(ValidationError):
            _EXPIRY.validate_python(text)
