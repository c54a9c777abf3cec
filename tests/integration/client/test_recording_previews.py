"""Previews of recordings in the SDK and the CLI."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import kleinkram
from kleinkram.cli import main as entry
from kleinkram.client import Client
from kleinkram.client.errors import PreviewMissing
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_mcap
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.upload_client import upload

pytestmark = pytest.mark.usefixtures("remembered_scenes")


@pytest.fixture(scope="module")
def client(api: Api) -> Iterator[Client]:
    with kleinkram.connect(api.url, api.token) as connected:
        yield connected


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    generate_mcap(path, size_bytes=2_000_000, seed=9)
    return path


@pytest.fixture(name="file_id", scope="module")
def _file_id(api: Api, drive: Path) -> str:
    mission_id = str(api.mission(api.project()["id"])["id"])
    file_id = str(upload(api, mission_id, "drive.mcap", drive.read_bytes())["id"])
    run_jobs(api)
    return file_id


def _run(monkeypatch: pytest.MonkeyPatch, api: Api, *arguments: object) -> int:
    monkeypatch.setenv("KLEINKRAM_URL", api.url)
    monkeypatch.setenv("KLEINKRAM_TOKEN", api.token or "")
    monkeypatch.setattr("sys.argv", ["klein", "file", "preview", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        entry.main()
    return int(ended.value.code or 0)


def test_the_sdk_returns_arrays_of_the_recording(client: Client, drive: Path, file_id: str) -> None:
    preview = client.files.preview(file_id)
    (imu,) = [series for series in preview.series if series.topic == "/imu/data"]
    (field,) = [field for field in imu.fields if field.name == "linear_acceleration.z"]
    with Recording.open(drive) as recording:
        values = recording.to_arrow("/imu/data", ["linear_acceleration.z"])["linear_acceleration.z"].to_numpy()
    assert imu.message_count == len(values)
    assert (field.low.min(), field.high.max()) == (values.min(), values.max())
    assert field.low.dtype == np.float64
    assert {track.kind.value for track in preview.tracks} == {"gnss", "pose"}
    assert preview.cameras[0].thumbnails[0].jpeg[:3] == b"\xff\xd8\xff"


def test_the_sdk_deletes_and_makes_previews(api: Api, client: Client, tmp_path: Path) -> None:
    generate_mcap(tmp_path / "other.mcap", size_bytes=300_000, seed=10)
    mission_id = str(api.mission(api.project()["id"])["id"])
    file_id = upload(api, mission_id, "other.mcap", (tmp_path / "other.mcap").read_bytes())["id"]
    with pytest.raises(PreviewMissing, match="has made none"):
        client.files.preview(file_id)
    run_jobs(api)
    client.files.preview(file_id)
    assert client.files.delete_preview(file_id).state.value == "deleted"
    with pytest.raises(PreviewMissing, match="was deleted"):
        client.files.preview(file_id)
    assert client.files.make_preview(file_id).state.value == "making"
    run_jobs(api)
    assert client.files.preview_state(file_id).state.value == "ready"


def test_the_command_shows_topics_and_writes_files(
    api: Api, file_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(monkeypatch, api, file_id) == 0
    shown = capsys.readouterr().out
    assert "/imu/data" in shown
    assert "thumbnails" in shown
    out = tmp_path / "preview"
    assert _run(monkeypatch, api, file_id, "-o", out, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert sorted(document["files"]) == sorted(path.name for path in out.iterdir())
    (imu,) = out.glob("series-*-imu.data.csv")
    with imu.open(newline="") as file:
        rows = list(csv.DictReader(file))
    (topic,) = [topic for topic in document["topics"] if topic["topic"] == "/imu/data"]
    assert 0 < len(rows) <= topic["messages"]
    assert all(float(row["linear_acceleration.z min"]) <= float(row["linear_acceleration.z max"]) for row in rows)
    with Image.open(next(out.glob("camera-*.jpg"))) as picture:
        assert picture.width == 160
    assert _run(monkeypatch, api, file_id, "-o", out) != 0, "the folder exists"
    assert "exists" in capsys.readouterr().err
