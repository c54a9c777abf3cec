"""Recordings on the server are exported through the SDK and the command line, mission by mission."""

import json
import uuid
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from kleinkram.cli import main as entry
from kleinkram.client import Client, connect
from kleinkram.client.errors import DestinationRefused, InvalidInput, NothingToDo
from kleinkram.contract.errors import NotFound
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_mcap
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.people import person
from tests.integration.upload_client import upload


@pytest.fixture(name="client")
def _client(api: Api) -> Iterator[Client]:
    with connect(api.url, api.token) as client:
        yield client


@pytest.fixture(name="drives", scope="module")
def _drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("drives")
    paths = [folder / f"{name}.mcap" for name in ("front", "rear")]
    for seed, path in enumerate(paths):
        generate_mcap(path, size_bytes=1_000_000, duration_s=2, seed=seed)
    return paths


@pytest.fixture(name="project")
def _project(api: Api, drives: list[Path]) -> str:
    """A project with the missions day, of two recordings, and night, of one."""
    project = api.project(name=f"export-{uuid.uuid4().hex[:8]}")
    day, night = (api.mission(project["id"], name=name)["id"] for name in ("day", "night"))
    for path in drives:
        upload(api, day, path.name, path.read_bytes())
    upload(api, night, "front.mcap", drives[0].read_bytes())
    upload(api, night, "notes.txt", b"not a recording")
    run_jobs(api)
    return str(project["name"])


def counts_of(path: Path, topic: str) -> int:
    with Recording.open(path) as recording:
        return recording.topic(topic).count or 0


def test_each_mission_has_a_folder(client: Client, project: str, drives: list[Path], tmp_path: Path) -> None:
    exports = client.export(project=project, dest=tmp_path / "out", topics="/imu/data")
    assert [(one.mission, one.folder, one.error) for one in exports] == [
        (name, tmp_path / "out" / project / name, None) for name in ("day", "night")
    ]
    day = pq.read_table(tmp_path / "out" / project / "day" / "imu.data.parquet")
    assert day.num_rows == sum(counts_of(path, "/imu/data") for path in drives)
    assert set(day["recording"].to_pylist()) == {"front.mcap", "rear.mcap"}
    times = day["log_time"].to_pylist()
    assert times == sorted(times)
    with pytest.raises(DestinationRefused, match="there is such a file or folder"):
        client.export(project=project, dest=tmp_path / "out", topics="/imu/data")
    again = client.export(project=project, dest=tmp_path / "out", topics="/imu/data", resume=True)
    assert [one.result for one in again] == [one.result for one in exports]


def test_one_mission_without_folders_above_it(client: Client, project: str, tmp_path: Path) -> None:
    (one,) = client.export(
        project=project, mission="night", dest=tmp_path / "out", to="images", topics="/camera/*", nested=False
    )
    assert one.result is not None
    assert one.result.files[0].path == tmp_path / "out" / "camera.image.compressed"
    with pytest.raises(InvalidInput, match="several missions"):
        client.export(project=project, dest=tmp_path / "other", nested=False)
    with pytest.raises(NothingToDo):
        client.export(project=project, path="notes.txt", dest=tmp_path / "other")


def test_a_file_of_a_mission(client: Client, project: str, drives: list[Path], tmp_path: Path) -> None:
    (one,) = client.export(project=project, mission="day", path="rear.mcap", dest=tmp_path, topics="/odom", to="csv")
    assert one.result is not None
    assert one.result.files[0].row_count == counts_of(drives[1], "/odom")


def test_the_command_line_exports_a_search(
    api: Api, project: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("KLEINKRAM_URL", api.url)
    monkeypatch.setenv("KLEINKRAM_TOKEN", str(api.token))

    def run(*arguments: object) -> int:
        monkeypatch.setattr("sys.argv", ["klein", "export", "--to", "csv", "--topics", "/odom", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            entry.main()
        return int(ended.value.code or 0)

    query = ("--query", f"project:{project}", "--json")
    assert run(*query, "--dry-run") == 0
    planned = json.loads(capsys.readouterr().out)["items"]
    assert [item["path"] for item in planned] == [f"{project}/{name}/odom.csv" for name in ("day", "night")]
    assert run(*query, "-o", tmp_path / "found") == 0
    items = json.loads(capsys.readouterr().out)["items"]
    assert [(item["project"], item["mission"]) for item in items] == [(project, "day"), (project, "night")]
    assert (tmp_path / "found" / project / "night" / "odom.csv").is_file()
    assert run("-p", project, "-m", "day", "-o", tmp_path / "one") == 0
    assert (tmp_path / "one" / "odom.csv").is_file()
    assert run("-p", project, "-m", "day", "-o", tmp_path / "one") == 11


def test_a_stranger_exports_nothing(api: Api, client: Client, project: str, tmp_path: Path) -> None:
    mission = client.missions.get("day", project=project)
    stranger = person(api)
    with connect(api.url, stranger.token) as other, pytest.raises((NotFound, NothingToDo)):
        other.export(mission=mission.id, dest=tmp_path / "out")
    assert not (tmp_path / "out").exists()
