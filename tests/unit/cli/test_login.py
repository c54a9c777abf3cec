"""Signing in on the command line: invalid arguments, and the display of saved servers."""

import datetime
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from kleinkram.cli.main import app
from kleinkram.client.config import SavedEndpoint, add_endpoint, load_endpoints
from kleinkram.client.errors import EndpointTaken, InvalidInput, NoBrowser, NotConfigured

LAB = "https://lab.example"


@pytest.fixture(autouse=True)
def _own_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("KLEINKRAM_DATA_DIR", str(tmp_path / "data"))
    for name in ("KLEINKRAM_URL", "KLEINKRAM_TOKEN", "BROWSER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


def klein(*arguments: str) -> Result:
    return CliRunner().invoke(app, [*arguments])


def test_device_and_token_exclude_each_other() -> None:
    assert isinstance(klein("login", LAB, "--device", "--token").exception, InvalidInput)


def test_login_requires_a_server() -> None:
    assert isinstance(klein("login").exception, NotConfigured)


@pytest.mark.parametrize("url", ["lab", f"{LAB}/s#klein_link_x", "https://ada:secret@lab.example"])
def test_invalid_server_addresses_are_refused(url: str) -> None:
    assert isinstance(klein("login", url).exception, InvalidInput)


def test_without_a_browser_the_device_sign_in_is_suggested() -> None:
    refused = klein("login", LAB).exception
    assert isinstance(refused, NoBrowser)
    assert f"klein login {LAB} --device" in str(refused)


def test_a_taken_endpoint_name_is_refused_before_sign_in() -> None:
    add_endpoint("lab", SavedEndpoint(url="https://other.example", token="t"))
    assert isinstance(klein("login", LAB, "--name", "lab").exception, EndpointTaken)


@pytest.mark.parametrize(
    ("url", "is_warned"), [("http://10.0.0.3:8000", True), ("http://127.0.0.1:8000", False), (LAB, False)]
)
def test_an_unencrypted_connection_is_reported(url: str, is_warned: bool) -> None:
    assert ("not encrypted" in klein("login", url).output) == is_warned


def test_endpoint_list_shows_accounts_and_expiry() -> None:
    past = datetime.datetime(2020, 1, 1, tzinfo=datetime.timezone.utc)
    later = datetime.datetime(2100, 1, 1, tzinfo=datetime.timezone.utc)
    add_endpoint("old", SavedEndpoint(url="https://old", token="old-secret", person="Ada", expires_at=past))
    add_endpoint("new", SavedEndpoint(url="https://new", token="new-secret", person="Ben", expires_at=later))
    add_endpoint("robot", SavedEndpoint(url="https://robot", token="robot-secret", person="Chloé"))
    add_endpoint("added", SavedEndpoint(url="https://added", token="added-secret"))
    shown = klein("endpoint", "list").output
    rows = {line.split()[0]: line for line in shown.splitlines()}
    assert "secret" not in shown
    assert rows["*"].split()[1:] == ["old", "https://old", "Ada", "2020-01-01T00:00:00Z", "(expired)"]
    assert rows["new"].split()[1:] == ["https://new", "Ben", "2100-01-01T00:00:00Z"]
    assert rows["robot"].endswith("no end")
    assert rows["added"].split()[1:] == ["https://added", "-", "-"]
    rows_by_name = {row["name"]: row for row in json.loads(klein("endpoint", "list", "--json").output)["items"]}
    assert {name: row["expired"] for name, row in rows_by_name.items()} == {
        "old": True,
        "new": False,
        "robot": False,
        "added": False,
    }


@pytest.mark.parametrize("arguments", [(), ("some-id", "--all"), ("no-id",)])
def test_session_revoke_requires_one_session(arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KLEINKRAM_URL", LAB)
    monkeypatch.setenv("KLEINKRAM_TOKEN", "t")
    assert isinstance(klein("session", "revoke", *arguments).exception, InvalidInput)


def test_logout_requires_one_endpoint() -> None:
    assert isinstance(klein("logout", "lab", "--all").exception, InvalidInput)
    assert isinstance(klein("logout").exception, NotConfigured)
    assert klein("logout", "--all").exit_code == 0
    assert load_endpoints().endpoints == {}


def test_logout_does_not_revoke_a_token_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KLEINKRAM_URL", LAB)
    monkeypatch.setenv("KLEINKRAM_TOKEN", "t")
    refused = klein("logout").exception
    assert isinstance(refused, InvalidInput)
    assert "KLEINKRAM_TOKEN" in str(refused)
