"""systemd units and examples of their settings agree with each other and with the server."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from kleinkram.server.environment import known_variables
from tests.integration.deploy.units import FOLDER, NAMES, example_settings

_SERVER_UNITS = ("api@", "backup", "bucket", "check", "migrate", "worker@")


def test_units_of_a_server_have_the_same_restrictions() -> None:
    blocks = set()
    for name in _SERVER_UNITS:
        text = (FOLDER / f"kleinkram-{name}.service").read_text()
        blocks.add(text[text.index("# The account has no rights") : text.index("LimitCORE=0")])
    assert len(blocks) == 1


def test_examples_have_settings_of_the_server_and_no_secret() -> None:
    variables = example_settings("kleinkram")
    assert variables.keys() <= {*known_variables()}
    assert not [name for name in variables if "PASSWORD" in name or "SECRET" in name]
    assert not {name for name in example_settings("backup") if name.startswith("KLEINKRAM_")}


@pytest.mark.parametrize("name", NAMES)
def test_every_credential_is_used(name: str) -> None:
    text = (FOLDER / name).read_text()
    for credential, source in re.findall(r"^LoadCredential=(.+):(.+)$", text, re.MULTILINE):
        assert source == f"/etc/kleinkram/credentials/{credential}"
        assert re.search(rf"(%d|\$\{{CREDENTIALS_DIRECTORY\}})/{credential}\b", text)


def test_the_store_says_why_it_does_not_start(tmp_path: Path) -> None:
    options = ["--folder", str(tmp_path), "--port", "9000", "--access-key", "kleinkram"]
    command = [sys.executable, "-m", "kleinkram.standalone.store_service", *options]
    missing = tmp_path / "s3-secret-key"
    done = subprocess.run([*command, "--secret-key-file", str(missing)], check=False, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == f"The store was not started: [Errno 2] No such file or directory: '{missing}'.\n"
