import ipaddress

import pytest
from pydantic import ValidationError

from kleinkram.server.proxies import asker, set_asker
from kleinkram.server.rate_limit import neighbourhood
from kleinkram.server.settings import Settings

TRUSTED = [ipaddress.ip_network("10.0.0.0/8"), ipaddress.ip_network("fd00::/8")]


@pytest.mark.parametrize(
    ("peer", "forwarded", "found"),
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
def test_the_nearest_that_is_no_proxy_of_ours(peer: str, forwarded: list[str], found: str) -> None:
    assert asker(peer, forwarded, TRUSTED) == found


@pytest.mark.parametrize(
    ("peer", "said", "scheme"),
    [("10.0.0.1", b"https", "https"), ("192.0.2.1", b"https", "http"), ("10.0.0.1", b"javascript", "http")],
)
def test_the_scheme_is_the_nearest_proxy_s_word(peer: str, said: bytes, scheme: str) -> None:
    scope = {"client": (peer, 1), "scheme": "http"}
    set_asker(scope, [(b"x-forwarded-proto", said)], TRUSTED)
    assert scope["scheme"] == scheme


def test_networks_are_read_from_one_line_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_one_subscriber_is_one_neighbourhood() -> None:
    assert neighbourhood("192.0.2.1") == "192.0.2.1"
    assert neighbourhood("2001:db8::1") == neighbourhood("2001:db8::ffff") == "2001:db8::/64"
    assert neighbourhood("elsewhere") == "elsewhere"
