"""Each attempt at a backup is recorded for the metrics."""

import os
import subprocess
from pathlib import Path

from kleinkram.server.settings import plain_dsn
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.klein import run_backup


def _create(api: Api, location: Path) -> "subprocess.CompletedProcess[str]":
    settings = api.app.state.settings
    values = {
        "DATABASE_URL": plain_dsn(settings.database_url),
        "S3_INTERNAL_URL": settings.s3_internal_url,
        "S3_BUCKET": settings.s3_bucket,
        "S3_ACCESS_KEY": settings.s3_access_key,
        "S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
    }
    environment = {name: value for name, value in os.environ.items() if not name.startswith("KLEINKRAM_")}
    environment |= {f"KLEINKRAM_{name}": value for name, value in values.items()}
    return run_backup({"command": "create", "location": str(location)}, environment)


def test_backups_and_failed_attempts_are_recorded(start_api: StartApi, tmp_path: Path) -> None:
    api = start_api()
    attempts = "SELECT snapshot_id IS NOT NULL, damaged_objects, ended_at >= started_at FROM backup_attempt"
    assert _create(api, tmp_path / "backups").returncode == 0
    assert api.sql(attempts) == [(True, 0, True)]
    (tmp_path / "file").write_text("not a folder")
    failed = _create(api, tmp_path / "file")
    assert (failed.returncode > 0, failed.stderr.count("\n")) == (True, 1)
    assert api.sql(f"{attempts} ORDER BY ended_at DESC LIMIT 1") == [(False, 0, True)]


def test_a_backup_that_cannot_be_recorded_is_complete(start_api: StartApi, tmp_path: Path) -> None:
    """For example, because its role may only read."""
    api = start_api()
    api.sql("ALTER TABLE backup_attempt RENAME TO of_an_older_schema")
    made = _create(api, tmp_path / "backups")
    assert made.returncode == 0
    assert "Warning: the metrics do not know of this attempt" in made.stderr
    assert "Traceback" not in made.stderr
