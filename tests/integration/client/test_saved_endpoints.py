"""The file of saved tokens: private, always complete, locked by one process at a time."""

import datetime
import subprocess
import sys
from pathlib import Path

import pytest

from kleinkram.client.config import (
    SavedEndpoint,
    SavedEndpoints,
    add_endpoint,
    endpoints_file,
    load_endpoints,
    name_for,
    remove_endpoint,
    use_endpoint,
)
from kleinkram.client.errors import ConfigurationBroken, CredentialsExposed, EndpointTaken, InvalidInput, NoSuchEndpoint

LAB = SavedEndpoint(url="https://lab", token="lab-secret", person="Ada", is_own=True)
FIELD = SavedEndpoint(
    url="http://field:8000", token="b", expires_at=datetime.datetime(2030, 1, 2, tzinfo=datetime.timezone.utc)
)
ADDS = """
import sys
from kleinkram.client.config import SavedEndpoint, add_endpoint
print("ready", flush=True)
sys.stdin.readline()
for number in range(10):
    add_endpoint(f"{sys.argv[1]}-{number}", SavedEndpoint(url="https://lab", token="t"))
"""


@pytest.fixture(autouse=True)
def _own_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def mode(path: Path) -> int:
    return path.stat().st_mode & 0o777


def test_only_the_owner_can_read_the_file() -> None:
    add_endpoint("lab", LAB)
    assert mode(endpoints_file()) == 0o600
    assert mode(endpoints_file().parent) == 0o700
    use_endpoint("lab")
    assert mode(endpoints_file()) == 0o600


@pytest.mark.parametrize("exposed", [0o644, 0o640, 0o604, 0o620, 0o660])
def test_a_file_that_others_may_read_or_change_is_refused(exposed: int) -> None:
    add_endpoint("lab", LAB)
    endpoints_file().chmod(exposed)
    for touch in (load_endpoints, lambda: add_endpoint("field", FIELD), lambda: remove_endpoint("lab")):
        with pytest.raises(CredentialsExposed, match="chmod 600") as refused:
            touch()
        assert f"{exposed:04o}" in str(refused.value)
    assert mode(endpoints_file()) == exposed, "it was left as it is"
    endpoints_file().chmod(0o600)
    assert load_endpoints().endpoints == {"lab": LAB}


def test_saved_endpoints_are_loaded() -> None:
    add_endpoint("lab", LAB)
    add_endpoint("field", FIELD)
    assert load_endpoints() == SavedEndpoints(current="lab", endpoints={"lab": LAB, "field": FIELD})


def test_a_file_of_an_earlier_version_is_loaded() -> None:
    endpoints_file().parent.mkdir(parents=True)
    endpoints_file().write_text('{"version": 1, "current": "x", "endpoints": {"x": {"url": "http://x", "token": "t"}}}')
    endpoints_file().chmod(0o600)
    saved = load_endpoints().endpoints["x"]
    assert (saved.person, saved.expires_at, saved.is_own) == (None, None, False)


def test_endpoints_are_selected_and_removed() -> None:
    add_endpoint("lab", LAB)
    add_endpoint("field", FIELD)
    assert load_endpoints().current == "lab", "the first is chosen, the second is not"
    use_endpoint("field")
    assert load_endpoints().current == "field"
    remove_endpoint("field")
    assert load_endpoints().current is None
    add_endpoint("field", FIELD, choose=True)
    add_endpoint("lab", LAB, choose=True)
    assert load_endpoints().current == "lab"
    for refused in (use_endpoint, remove_endpoint):
        with pytest.raises(NoSuchEndpoint, match="lab"):
            refused("nowhere")


def test_a_name_cannot_change_its_server() -> None:
    add_endpoint("lab", LAB)
    add_endpoint("lab", LAB.model_copy(update={"token": "newer"}))
    with pytest.raises(EndpointTaken, match="https://lab"):
        add_endpoint("lab", FIELD)
    assert load_endpoints().endpoints["lab"].token == "newer"


def test_logout_forgets_only_the_named_token() -> None:
    add_endpoint("lab", LAB)
    remove_endpoint("lab", token="another")
    assert "lab" in load_endpoints().endpoints
    remove_endpoint("lab", token=LAB.token)
    assert load_endpoints().endpoints == {}


@pytest.mark.parametrize(("name", "token"), [("", "t"), ("lab", "")])
def test_an_endpoint_without_name_or_token_is_refused(name: str, token: str) -> None:
    with pytest.raises(InvalidInput):
        add_endpoint(name, SavedEndpoint(url="https://lab", token=token))


def test_servers_are_called_by_their_hosts() -> None:
    add_endpoint("my lab", LAB)
    saved = load_endpoints()
    assert name_for("https://lab", saved) == "my lab"
    assert name_for("https://kleinkram.lab.example", saved) == "kleinkram.lab.example"
    assert name_for("http://10.0.0.3:8000", saved) == "10.0.0.3:8000"


def test_a_token_is_not_in_what_is_printed() -> None:
    assert "lab-secret" not in repr(SavedEndpoints(endpoints={"lab": LAB}))
    assert "https://lab" in repr(LAB)


def test_a_secret_is_not_in_the_error_of_a_broken_file() -> None:
    endpoints_file().parent.mkdir(parents=True)
    endpoints_file().write_text('{"endpoints": {"lab": {"url": 3, "token": "lab-secret"}}}')
    endpoints_file().chmod(0o600)
    with pytest.raises(ConfigurationBroken) as broken:
        load_endpoints()
    assert "lab-secret" not in str(broken.value)


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path: Path) -> None:
    (tmp_path / "config").write_text("not a folder")
    with pytest.raises(ConfigurationBroken, match=r"endpoints\.json"):
        add_endpoint("lab", LAB)


def test_processes_that_save_at_the_same_time_lose_nothing() -> None:
    started = [
        subprocess.Popen(
            [sys.executable, "-c", ADDS, who], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        for who in ("one", "two", "three")
    ]
    for process in started:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in started:
        process.communicate("go\n", timeout=60)
        assert process.returncode == 0
    assert set(load_endpoints().endpoints) == {
        f"{who}-{number}" for who in ("one", "two", "three") for number in range(10)
    }
    left = {path.name for path in endpoints_file().parent.iterdir()}
    assert left == {"endpoints.json", "endpoints.lock"}
