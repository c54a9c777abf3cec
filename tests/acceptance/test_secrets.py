"""Logs and files written by `klein up` contain no secret."""

import re
import secrets
from pathlib import Path

from kleinkram.standalone.data_dir import DataDir, load_secrets
from tests.acceptance.conftest import Instance, Terminal


def test_the_logs_of_klein_up_contain_no_secret(
    instance: Instance, terminal: Terminal, project: str, tmp_path: Path
) -> None:
    body = tmp_path / "a.bin"
    body.write_bytes(secrets.token_bytes(2000))
    terminal.run("upload", body, "-p", project, "-m", "m", "--create")
    terminal.run("download", "-p", project, "--dest", tmp_path / "d")
    token = terminal.run("token", "create", "robot", "--json").json()["secret"]
    terminal.run("project", "list", "--json")
    folder = DataDir(instance.data_dir)
    stored = load_secrets(folder)
    known = {
        "the owner's token": folder.token_file.read_text().strip(),
        "a token": token,
        "a password of PostgreSQL": stored.postgres_serve,
        "the password that migrates": stored.postgres_migrate,
        "the password of the superuser": stored.postgres_admin,
        "the store's key": stored.s3_secret_key,
    }
    logs = sorted(folder.log("api").parent.glob("*.log*"))
    assert {"api.log", "worker.log", "postgres.log", "store.log"} <= {log.name for log in logs}
    for log in logs:
        text = log.read_text(errors="replace")
        assert [name for name, secret in known.items() if secret in text] == [], log.name
        assert re.search(r"X-Amz-Signature=[0-9a-f]{64}", text) is None, log.name
