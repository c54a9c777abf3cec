import ipaddress

import pytest
from pydantic import ValidationError

from kleinkram.server.http.headers import client_address, set_client_address
from kleinkram.server.http.rate_limit import subscriber_network
from kleinkram.server.settings import Settings

TRUSTED = [ipaddress.ip_network("10.0.0.0/8"), ipaddress.ip_network("fd00::/8")]


@pytest.mark.parametrize(
    ("peer", "forwarded_for", "expected"),
    [
        ("203.0.113.1", [], "203.0.113.1"),
        ("203.0.113.1", ["192.0.2.1"], "203.0.113.1"),
        ("10.0.0.1", [], "10.0.0.1"),
        ("10.0.0.1", ["192.0.2.1"], "192.0.2.1"),
        ("10.0.0.1", ["198.51.100.7", "192.0.2.1"], "192.0.2.1"),
        ("10.0.0.1", ["198.51.100.7", "192.0.2.1", "10.0.0.2"], "192.0.2.1"),
        ("10.0.0.1", ["10.0.0.3", "10.0.0.2"], "10.0.0.3"),
        ("10.0.0.1", ["198.51.100.7", "unknown"], "10.0.0.1"),
        ("10.0.0.1", ["198.51.100.7", ""], "10.0.0.1"),
        ("10.0.0.1", ["<script>"], "10.0.0.1"),
        ("::ffff:10.0.0.1", ["192.0.2.1"], "192.0.2.1"),
        ("fd00::1", ["[2001:db8::1]"], "2001:db8::1"),
        ("testclient", ["192.0.2.1"], "testclient"),
    ],
)
def test_client_address_is_the_nearest_that_is_not_a_trusted_proxy(
    peer: str, forwarded_for: list[str], expected: str
) -> None:
    assert client_address(peer, forwarded_for, TRUSTED) == expected


@pytest.mark.parametrize(
    ("peer", "forwarded_scheme", "scheme"),
    [("10.0.0.1", b"https", "https"), ("192.0.2.1", b"https", "http"), ("10.0.0.1", b"javascript", "http")],
)
def test_scheme_comes_from_the_nearest_trusted_proxy(peer: str, forwarded_scheme: bytes, scheme: str) -> None:
    scope = {"client": (peer, 1), "scheme": "http", "headers": [(b"x-forwarded-proto", forwarded_scheme)]}
    set_client_address(scope, TRUSTED)
    assert scope["scheme"] == scheme


def test_trusted_proxies_are_read_from_one_environment_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {
        "DATABASE_URL": "postgresql://a@b/c",
        "S3_INTERNAL_URL": "http://s",
        "S3_ACCESS_KEY": "a",
    }.items():
        monkeypatch.setenv(f"KLEINKRAM_{name}", value)
    monkeypatch.setenv("KLEINKRAM_S3_SECRET_KEY", "x")
    assert Settings().trusted_proxies == ()
    monkeypatch.setenv("KLEINKRAM_TRUSTED_PROXIES", "10.0.0.0/8, fd00::/8,")
    assert [*Settings().trusted_proxies] == TRUSTED
    monkeypatch.setenv("KLEINKRAM_TRUSTED_PROXIES", "10.0.0.1/8")
    with pytest.raises(ValidationError, match="host bits set"):
        Settings()


def test_an_ipv6_subscriber_is_its_64_network() -> None:
    assert subscriber_network("192.0.2.1") == "192.0.2.1"
    assert subscriber_network("2001:db8::1") == subscriber_network("2001:db8::ffff") == "2001:db8::/64"
    assert subscriber_network("elsewhere") == "elsewhere"
