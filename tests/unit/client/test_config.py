"""Which server is used, and why."""

import json
from pathlib import Path

import pytest

from kleinkram import connect
from kleinkram.client.config import (
    EndpointSource,
    SavedEndpoint,
    add_endpoint,
    endpoints_file,
    find_endpoint,
    normal_url,
)
from kleinkram.client.errors import ConfigurationBroken, InvalidInput, NotConfigured


@pytest.fixture(autouse=True)
def _own_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("KLEINKRAM_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.delenv("KLEINKRAM_URL", raising=False)
    monkeypatch.delenv("KLEINKRAM_TOKEN", raising=False)


@pytest.fixture
def local(tmp_path: Path) -> Path:
    """An instance of `klein up`."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "token").write_text("local-token\n")
    instance = tmp_path / "data" / "instance.json"
    instance.write_text(json.dumps({"url": "http://127.0.0.1:8000", "token_file": "token", "more": 1}))
    return instance


def test_no_endpoint_explains_what_to_do() -> None:
    with pytest.raises(NotConfigured, match="klein up"):
        find_endpoint()


def test_endpoints_are_searched_in_the_documented_order(local: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (find_endpoint().source, find_endpoint().token) == (EndpointSource.local, "local-token")
    add_endpoint("lab", SavedEndpoint(url="https://lab/", token="lab-token"))
    assert (find_endpoint().source, find_endpoint().url) == (EndpointSource.chosen, "https://lab")
    monkeypatch.setenv("KLEINKRAM_URL", "http://env:1")
    monkeypatch.setenv("KLEINKRAM_TOKEN", "env-token")
    assert (find_endpoint().source, find_endpoint().token) == (EndpointSource.environment, "env-token")
    endpoint = find_endpoint("http://arg:1", "arg-token")
    assert (endpoint.source, endpoint.token) == (EndpointSource.argument, "arg-token")


def test_a_token_is_sent_only_to_its_server(local: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_endpoint("lab", SavedEndpoint(url="https://lab", token="lab-token"))
    monkeypatch.setenv("KLEINKRAM_URL", "https://lab")
    assert find_endpoint().token == "lab-token"
    monkeypatch.setenv("KLEINKRAM_URL", "http://127.0.0.1:8000/")
    assert find_endpoint().token == "local-token"
    monkeypatch.setenv("KLEINKRAM_URL", "https://elsewhere")
    assert find_endpoint().token is None, "a stranger there"


def test_the_url_of_a_share_link_is_a_server_and_a_secret(monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint = find_endpoint("https://lab/s#klein_link_x")
    assert (endpoint.url, endpoint.token) == ("https://lab", "klein_link_x")
    assert "klein_link_x" not in repr(endpoint)
    monkeypatch.setenv("KLEINKRAM_URL", "https://lab/below/s#klein_link_y")
    monkeypatch.setenv("KLEINKRAM_TOKEN", "of-another-server")
    assert (find_endpoint().url, find_endpoint().token) == ("https://lab/below", "klein_link_y")


def test_a_missing_token_is_reported_with_instructions(caplog: pytest.LogCaptureFixture) -> None:
    connect("https://elsewhere").close()
    assert "https://elsewhere" in caplog.text
    assert "only what is public" in caplog.text


@pytest.mark.parametrize("content", ["", "{", '{"endpoints": 3}'])
def test_a_broken_file_is_named(content: str) -> None:
    endpoints_file().parent.mkdir(parents=True)
    endpoints_file().write_text(content)
    endpoints_file().chmod(0o600)
    with pytest.raises(ConfigurationBroken, match=r"endpoints\.json"):
        find_endpoint()


def test_a_broken_instance_is_named(local: Path) -> None:
    local.write_text("{}")
    with pytest.raises(ConfigurationBroken, match=r"instance\.json"):
        find_endpoint()


@pytest.mark.parametrize(
    "url",
    [
        *("lab", "ftp://lab", "http://", "http://lab:port", "http://lab:99999"),
        *("https://ada:secret@lab", "https://lab/s#klein_link_x", "https://lab?token=x"),
    ],
)
def test_invalid_urls_are_refused(url: str) -> None:
    with pytest.raises(InvalidInput):
        normal_url(url)
