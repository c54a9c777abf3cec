"""`klein cut`, and `klein download --topics --start-time --end-time`, on local files and on a server."""

import json
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from kleinkram.client import Client, connect
from kleinkram.client.errors import DestinationRefused, InvalidInput, NothingToDo
from kleinkram.contract.errors import NotFound
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from kleinkram.recordings.writing.mcap import MADE_FROM
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.test_cli import Klein, klein_at
from tests.recording_files.whole_mcap import read_whole_mcap

RANGE = ("--start", "+4s", "--end", "+6s")


@pytest.fixture(name="klein", scope="module")
def _klein(api: Api, tmp_path_factory: pytest.TempPathFactory) -> Klein:
    return klein_at(api, tmp_path_factory.mktemp("home"))


@pytest.fixture(name="drives", scope="module")
def _drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of 10 s that overlap: an MCAP and a bag in a folder; a text file beside them."""
    folder: Path = tmp_path_factory.mktemp("drives")
    generate_mcap(folder / "drive.mcap", size_bytes=4_000_000, duration_s=10)
    (folder / "nuc").mkdir()
    generate_bag(folder / "nuc" / "drive2.bag", size_bytes=2_000_000, duration_s=10, seed=2)
    (folder / "notes.txt").write_text("notes")
    return folder


@pytest.fixture(name="mission", scope="module")
def _mission(api: Api, drives: Path) -> str:
    """A mission with these files, read by the server."""
    mission_id = str(api.mission(api.project()["id"])["id"])
    with connect(api.url, api.token) as client:
        client.upload(f"{drives}/", uuid.UUID(mission_id))
    run_jobs(api)
    return mission_id


@pytest.fixture(name="client")
def _client(api: Api) -> Iterator[Client]:
    with connect(api.url, api.token) as client:
        yield client


def expected(path: Path, *topics: str, start: str = "+4s", end: str = "+6s") -> list[tuple[str, int, bytes]]:
    with Recording.open(path) as recording:
        messages = recording.raw_messages(topics, start=start, end=end)
        return [(message.topic, message.log_time_ns, message.data) for message in messages]


def stamped(path: Path) -> list[tuple[str, int, bytes]]:
    return [(topic, log_ns, data) for topic, log_ns, _, _, data in read_whole_mcap(path).messages]


def test_cut_of_a_local_file(klein: Klein, drives: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.mcap"
    cut = ("cut", drives / "drive.mcap", "--topics", "/imu/data,/odom", *RANGE, "-o", target)
    document: dict[str, Any] = json.loads(klein(*cut, "--json").stdout)
    assert stamped(target) == expected(drives / "drive.mcap", "/imu/data", "/odom")
    assert document["message_count"] == len(stamped(target)) > 100
    assert document["size_bytes"] == target.stat().st_size < (drives / "drive.mcap").stat().st_size / 4
    assert (document["topics"], document["losses"]) == (["/imu/data", "/odom"], [])
    assert document["end_ns"] - document["start_ns"] == 2 * 10**9
    assert "is not replaced" in klein(*cut, code=11).stderr


def test_cut_of_a_folder_merges_its_recordings(klein: Klein, drives: Path, tmp_path: Path) -> None:
    klein("cut", drives, "--topics", "/imu/data", *RANGE, "-o", tmp_path / "out.mcap")
    both = [*expected(drives / "drive.mcap", "/imu/data"), *expected(drives / "nuc" / "drive2.bag", "/imu/data")]
    assert sorted(stamped(tmp_path / "out.mcap")) == sorted(both)


def test_what_is_wrong_with_a_cut_is_named(klein: Klein, drives: Path, tmp_path: Path) -> None:
    source, out = drives / "drive.mcap", ("-o", tmp_path / "out.mcap")
    for arguments, code, text in (
        ((source, *RANGE), 2, "specify the file to write: -o"),
        (out, 2, "specify files or folders, or a mission with -m"),
        ((source, "--topics", "/nothing", *out), 3, "there is no topic /nothing; the recording has"),
        ((source, "--topics", "/nothing*", *out), 3, "No topic matches /nothing*"),
        ((source, "--start", "+6s", "--end", "+4s", *out), 2, "is not after the start"),
        ((source, "--start", "noon", *out), 2, "'noon' is no time; write it like"),
        ((source, "--start", "+1h", *out), 3, "nothing was recorded from"),
        (("-m", "x", "--topics", "/imu/data"), 2, "specify the file to write: -o"),
        ((drives / "none.mcap", *out), 8, "there is no such file"),
        ((drives / "notes.txt", *out), 8, "notes.txt"),
    ):
        assert text in klein("cut", *arguments, code=code).stderr
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_shows_how_much_would_be_read(klein: Klein, drives: Path) -> None:
    dry = klein("cut", drives, *RANGE, "--dry-run", "--json")
    items = json.loads(dry.stdout)["items"]
    sizes = {Path(item["recording"]).name: item["chunk_bytes"] for item in items}
    assert sizes.keys() == {"drive.mcap", "drive2.bag"}
    assert 0 < sizes["drive.mcap"] < (drives / "drive.mcap").stat().st_size


def test_cut_on_the_server_gives_the_bytes_of_a_local_one(
    klein: Klein,
    api: Api,
    mission: str,
    drives: Path,
    tmp_path: Path,
) -> None:
    """Except for the SHA-256 of the source, which only the server knows."""
    klein("cut", "-m", mission, "drive.mcap", "--topics", "/imu/data", *RANGE, "-o", tmp_path / "far.mcap")
    klein("cut", drives / "drive.mcap", "--topics", "/imu/data", *RANGE, "-o", tmp_path / "near.mcap")
    far, near = read_whole_mcap(tmp_path / "far.mcap"), read_whole_mcap(tmp_path / "near.mcap")
    assert (far.messages, far.channels, far.schemas) == (near.messages, near.channels, near.schemas)
    (file,) = json.loads(far.metadata_of(MADE_FROM)["files"])
    assert file["name"] == "drive.mcap"
    assert len(file["sha256"]) == 64
    klein("cut", "-m", mission, *RANGE, "-o", tmp_path / "all.mcap")
    klein("cut", drives, *RANGE, "-o", tmp_path / "all-near.mcap")
    assert read_whole_mcap(tmp_path / "all.mcap").messages == read_whole_mcap(tmp_path / "all-near.mcap").messages
    assert "There is no recording 'other.bag'" in klein("cut", "-m", mission, "other.bag", "-o", "x", code=3).stderr


def test_a_recording_of_unknown_times_is_opened_to_learn_them(
    api: Api, klein: Klein, mission: str, drives: Path, tmp_path: Path
) -> None:
    """As directly after an upload."""
    (known,) = api.sql(
        "SELECT id, start_ns, end_ns FROM recording WHERE mission_id = %s AND name = %s", mission, "drive.mcap"
    )
    api.sql("UPDATE recording SET start_ns = NULL, end_ns = NULL WHERE id = %s", known[0])
    try:
        common = ("-m", mission, "--topics", "/imu/data", *RANGE)
        klein("cut", "drive.mcap", *common, "-o", tmp_path / "out.mcap")
        klein("export", *common, "--to", "csv", "-o", tmp_path / "tables")
    finally:
        api.sql("UPDATE recording SET start_ns = %s, end_ns = %s WHERE id = %s", *known[1:], known[0])
    assert stamped(tmp_path / "out.mcap") == expected(drives / "drive.mcap", "/imu/data")
    assert (tmp_path / "tables" / "index.json").exists()


def test_a_stranger_cannot_cut(klein: Klein, mission: str, tmp_path: Path) -> None:
    """Nor learn that there is such a mission."""
    refused = klein("cut", "-m", mission, "-o", tmp_path / "out.mcap", code=3, KLEINKRAM_TOKEN="")
    assert "There is no mission" in refused.stderr
    assert not (tmp_path / "out.mcap").exists()


def test_download_of_slices_writes_one_file_for_each_recording(
    klein: Klein,
    mission: str,
    drives: Path,
    tmp_path: Path,
) -> None:
    words = ("--topics", "/imu/data", "--start-time", "+4s", "--end-time", "+6s", "--dest", tmp_path)
    document = json.loads(klein("download", "-m", mission, *words, "--json").stdout)
    assert {Path(item["local"]).relative_to(tmp_path).as_posix() for item in document["items"]} == {
        "drive.mcap",
        "nuc/drive2.mcap",
    }
    assert {item["outcome"] for item in document["items"]} == {"downloaded"}
    assert stamped(tmp_path / "drive.mcap") == expected(drives / "drive.mcap", "/imu/data")
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == ["drive.mcap", "drive2.mcap"]
    refused = klein("download", "-m", mission, *words, "--limit-rate", "1M", code=2)
    assert "it does not limit slices of recordings" in refused.stderr
    assert "it exists, and is not compared" in klein("download", "-m", mission, *words, code=11).stderr
    klein("download", "-m", mission, *words, "--overwrite")
    assert stamped(tmp_path / "drive.mcap") == expected(drives / "drive.mcap", "/imu/data")


def test_slices_by_the_sdk(client: Client, mission: str, drives: Path, tmp_path: Path) -> None:
    where = client.missions.get(mission)
    report = client.download(where, tmp_path, topics=["/imu/data", "/odom"], start="+4s", end="+6s", path="drive.mcap")
    (result,) = report.results
    assert result.local == tmp_path / "drive.mcap"
    assert result.losses == ()
    assert stamped(result.local) == expected(drives / "drive.mcap", "/imu/data", "/odom")
    again = client.download(where, tmp_path, topics="/imu/data", path="drive.mcap")
    assert [type(error) for error in again.failures] == [DestinationRefused]
    other = tmp_path / "other"
    with pytest.raises(NothingToDo, match="No recording has a topic /nothing"):
        client.download(where, other, topics="/nothing")
    with pytest.raises(NothingToDo, match="nothing was recorded from"):
        client.download(where, other, start="+1h")
    with pytest.raises(InvalidInput, match="is not after the start"):
        client.download(where, other, start="+6s", end="+4s")
    with pytest.raises(InvalidInput, match="is no time"):
        client.download(where, other, start="noon")
    assert not other.exists()
    with pytest.raises(NotFound):
        client.download(uuid.uuid4(), other, topics="/imu/data")


def test_a_rosbag2_folder_on_the_server_becomes_one_slice(api: Api, client: Client, tmp_path: Path) -> None:
    mission_id = uuid.UUID(str(api.mission(api.project()["id"])["id"]))
    generate_db3(tmp_path / "run", duration_s=10, size_bytes=1_000_000)
    client.upload(tmp_path / "run", mission_id)
    run_jobs(api)
    report = client.download(client.missions.get(mission_id), tmp_path / "cut", start="+4s", end="+6s")
    (result,) = report.results
    assert (result.error, result.local) == (None, tmp_path / "cut" / "run.mcap")
    with Recording.open(tmp_path / "run") as recording:
        count = len(list(recording.raw_messages(start="+4s", end="+6s")))
    with Recording.open(result.local) as cut:
        assert cut.message_count is not None
        assert cut.message_count >= count > 0
