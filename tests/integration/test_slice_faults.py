"""Slices, conversions and exports when files, disks, addresses and rights are not as expected."""

from __future__ import annotations

import json
import resource
import shlex
import subprocess
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kleinkram.cli import main as entry
from kleinkram.client import Client, connect
from kleinkram.client.files import Files, Recordings
from kleinkram.contract.files import DownloadLinks
from kleinkram.recordings import (
    BagOptions,
    ExportFormat,
    McapOptions,
    NamedRecording,
    Recording,
    SourceError,
    export_recordings,
    sources,
)
from kleinkram.recordings.sample import generate_mcap
from kleinkram.recordings.writing.conversion import convert_recording
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.people import person
from tests.klein import KLEIN
from tests.recording_files.builders import T0
from tests.recording_files.ros_messages import SECOND, TimedMessage, ros2_mcap
from tests.recording_files.whole_mcap import read_whole_mcap

Klein = Callable[..., tuple[int, str, str]]
"""Runs a command in this process; returns exit code, stdout and stderr."""

MANY = 200
MAX_DESCRIPTORS = 64
_FULL_BYTES = 100_000


@pytest.fixture(name="klein")
def _klein(api: Api, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Klein:
    monkeypatch.setenv("KLEINKRAM_URL", api.url)

    def run(*arguments: object, token: str | None = None) -> tuple[int, str, str]:
        monkeypatch.setenv("KLEINKRAM_TOKEN", token or str(api.token))
        monkeypatch.setattr("sys.argv", ["klein", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            entry.main()
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    return run


@pytest.fixture(name="drives", scope="module")
def _drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings: one whole, one damaged in a chunk of its middle, one of months before."""
    folder: Path = tmp_path_factory.mktemp("drives")
    generate_mcap(folder / "drive.mcap", size_bytes=3_000_000, duration_s=10)
    data = bytearray((folder / "drive.mcap").read_bytes())
    data[len(data) // 2 : len(data) // 2 + 200] = bytes(200)
    (folder / "damaged.mcap").write_bytes(data)
    early = ros2_mcap(imu(second) for second in range(10))
    (folder / "early.mcap").write_bytes(early.read(0, early.size_bytes))
    return folder


def imu(seconds: int, offset_ns: int = 0) -> TimedMessage:
    log_ns = T0 + seconds * SECOND + offset_ns
    return TimedMessage("/imu/data", "sensor_msgs/Imu", log_ns, {}, log_ns)


@pytest.fixture(name="mission", scope="module")
def _mission(api: Api, drives: Path) -> str:
    mission_id = str(api.mission(api.project()["id"])["id"])
    with connect(api.url, api.token) as client:
        client.upload(f"{drives}/", uuid.UUID(mission_id))
    run_jobs(api)
    return mission_id


@pytest.fixture(name="client")
def _client(api: Api) -> Iterator[Client]:
    with connect(api.url, api.token) as client:
        yield client


def written(folder: Path) -> list[str]:
    """Return the names of all files, also hidden ones."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


# A person without the right


@pytest.mark.parametrize(
    "command",
    [("cut", "-o", "out.mcap"), ("download", "--topics", "/imu/data"), ("export", "--to", "csv", "-o", "out")],
    ids=lambda command: command[0],
)
def test_a_person_without_the_right_gets_nothing(
    klein: Klein, api: Api, mission: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    """Nor learns that there is such a mission."""
    monkeypatch.chdir(tmp_path)
    code, out, err = klein(*command, "-m", mission, token=person(api).token)
    assert (code, out) == (3, "")
    assert err.startswith("Error: There is no ")
    assert written(tmp_path) == []


# Addresses that expire


@pytest.mark.parametrize("command", ["cut", "download", "export"])
def test_expired_addresses_are_renewed(
    klein: Klein, mission: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """The store refuses the first addresses, as it does an hour after they were signed."""
    real, renewals = Files.links, 0

    def links(files: Files, file_ids: list[uuid.UUID]) -> DownloadLinks:
        nonlocal renewals
        answer = real(files, file_ids)
        renewals += 1
        if renewals > 1:
            return answer
        expired = [link.model_copy(update={"url": f"{link.url[:-8]}00000000"}) for link in answer.items]
        return answer.model_copy(update={"items": expired})

    monkeypatch.setattr(Files, "links", links)
    only = ("--topics", "/imu/data", "--start", "+2s", "--end", "+8s")
    arguments = {
        "cut": ("cut", "drive.mcap", "-o", tmp_path / "drive.mcap"),
        "download": ("download", "drive.mcap", "-o", tmp_path),
        "export": ("export", "drive.mcap", "--to", "csv", "-o", tmp_path / "out"),
    }
    code, _, err = klein(*arguments[command], "-m", mission, *only)
    assert (code, renewals) == (0, 2), err
    if command != "export":
        assert len(read_whole_mcap(tmp_path / "drive.mcap").messages) > 500


# A damaged recording


def test_what_a_damaged_recording_has_lost_is_in_every_result(
    klein: Klein, client: Client, mission: str, drives: Path, tmp_path: Path
) -> None:
    code, out, err = klein("cut", drives / "damaged.mcap", "--start", "+1s", "-o", tmp_path / "cut.mcap", "--json")
    (loss,) = json.loads(out)["losses"]
    assert (code, loss["file"]) == (0, "damaged.mcap")
    assert err.startswith("Lost: damaged.mcap: chunk at byte ")
    whole = len(read_whole_mcap(drives / "drive.mcap").messages)
    report = client.download(client.missions.get(mission), tmp_path, start="+0s", path="damaged.mcap")
    (result,) = report.results
    assert result.losses == (f"damaged.mcap: {loss['reason']}",)
    assert 0 < len(read_whole_mcap(result.local).messages) < whole
    code, out, err = klein("download", "-m", mission, "damaged.mcap", "--start", "+0s", "-o", tmp_path / "d", "--json")
    assert (code, json.loads(out)["items"][0]["losses"]) == (0, [*result.losses])
    code, out, err = klein("export", drives / "damaged.mcap", "--to", "csv", "-o", tmp_path / "out")
    assert (code, "damaged.mcap: chunk at byte " in err) == (0, True)
    problems = json.loads((tmp_path / "out" / "index.json").read_text())["problems"]
    assert {problem["recording"] for problem in problems} == {"damaged.mcap"}


# A full disk


@pytest.fixture(name="full_disk")
def _full_disk() -> Iterator[None]:
    """A limit on the size of files stands for a full disk: both fail in the same call."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FULL_BYTES, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("command", ["cut", "download", "mcap", "bag", "export"])
def test_a_full_disk_is_named_and_no_file_is_left_under_its_name(
    klein: Klein, mission: str, drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    drive = drives / "drive.mcap"
    arguments: dict[str, tuple[object, ...]] = {
        "cut": ("cut", drive, "-o", "drive.mcap"),
        "download": ("download", "-m", mission, "drive.mcap", "--start", "+0s"),
        "mcap": ("convert", drive, "--level", 19),
        "bag": ("convert", drive, "--to", "bag"),
        "export": ("export", drive, "--to", "csv", "-o", "out", "--topics", "/gps/fix,/imu/data"),
    }
    code, _, err = klein(*arguments[command])
    assert code == 11
    assert "File too large" in err
    complete = ["out/.export.jsonl", "out/gps.fix.csv"] if command == "export" else []
    assert written(tmp_path) == complete


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_leaves_the_slice_that_should_be_replaced(
    klein: Klein, mission: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.mcap").write_bytes(b"mine")
    code, _, err = klein("download", "-m", mission, "drive.mcap", "--start", "+0s", "--overwrite")
    assert (code, "File too large" in err) == (11, True)
    assert written(tmp_path) == ["drive.mcap"]
    assert (tmp_path / "drive.mcap").read_bytes() == b"mine"


# A file that changes


def convert_to(options: McapOptions | BagOptions) -> Callable[[Recording, Path], object]:
    return lambda recording, path: convert_recording(recording, path, options)


def export_to(to: ExportFormat) -> Callable[[Recording, Path], object]:
    return lambda recording, path: export_recordings([NamedRecording("drive", recording)], path, to)


@pytest.mark.parametrize(
    "write",
    [convert_to(McapOptions()), convert_to(BagOptions()), export_to(ExportFormat.csv), export_to(ExportFormat.parquet)],
    ids=["mcap", "bag", "csv", "parquet"],
)
def test_a_file_that_changes_is_an_error(
    tmp_path: Path, drives: Path, write: Callable[[Recording, Path], object]
) -> None:
    source = tmp_path / "early.mcap"
    source.write_bytes((drives / "early.mcap").read_bytes())
    with Recording.open(source) as recording:
        with source.open("ab") as stream:
            stream.write(b"more")
        with pytest.raises(SourceError, match=r"early\.mcap: changed while it was read; wait until no program writes"):
            write(recording, tmp_path / "out")
    assert set(written(tmp_path)) <= {"early.mcap", "out/.export.jsonl", "out/imu.data.csv", "out/imu.data.parquet"}
    assert not (tmp_path / "out").is_file()


# Clocks that jump


def test_an_export_of_clocks_that_jump_is_in_the_order_of_log_time(klein: Klein, tmp_path: Path) -> None:
    """One clock goes back by half a minute in the middle."""
    source = ros2_mcap((imu(100 + step - 60 * (step > 50)) for step in range(100)), chunk_bytes=2000)
    (tmp_path / "back.mcap").write_bytes(source.read(0, source.size_bytes))
    code, _, err = klein("export", tmp_path / "back.mcap", "--to", "csv", "-o", tmp_path / "out")
    assert code == 0, err
    lines = (tmp_path / "out" / "imu.data.csv").read_text().splitlines()
    times = [int(line.partition(",")[0]) for line in lines[1:]]
    assert times == sorted(times)
    assert len(times) == 100


# Many recordings


@pytest.fixture(name="many", scope="module")
def _many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings that all overlap in time."""
    folder: Path = tmp_path_factory.mktemp("many")
    for number in range(MANY):
        source = ros2_mcap(imu(second, number) for second in range(3))
        (folder / f"{number:03}.mcap").write_bytes(source.read(0, source.size_bytes))
    return folder


@pytest.mark.parametrize("command", ["cut", "export"])
def test_more_recordings_than_files_may_be_open(many: Path, tmp_path: Path, command: str) -> None:
    words = {"cut": ["-o", str(tmp_path / "out")], "export": ["--to", "csv", "-o", str(tmp_path / "out")]}[command]
    line = shlex.join([str(KLEIN), command, str(many), *words, "--json"])
    done = subprocess.run(
        ["sh", "-c", f"ulimit -n {MAX_DESCRIPTORS}; exec {line}"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    rows = document["message_count"] if command == "cut" else document["items"][0]["files"][0]["row_count"]
    assert rows == 3 * MANY


def test_a_file_that_is_not_open_files_is_read_and_checked(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "drive.mcap"
    source.write_bytes((drives / "early.mcap").read_bytes())
    before = len([*Path("/proc/self/fd").iterdir()])
    monkeypatch.setattr(sources, "MAX_OPEN_FILES", 0)
    with Recording.open(source) as recording:
        assert len([*Path("/proc/self/fd").iterdir()]) == before
        assert len(list(recording.raw_messages())) == 10
        (tmp_path / "other").write_bytes(source.read_bytes())
        (tmp_path / "other").replace(source)
        with pytest.raises(SourceError, match=r"drive\.mcap: was replaced while it was read"):
            list(recording.raw_messages())


@pytest.mark.parametrize("command", ["cut", "download", "export"])
def test_recordings_outside_the_range_are_not_opened(
    klein: Klein, mission: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    opened: list[str] = []
    real = Recordings.open

    def spy(recordings: Recordings, what: object, **settings: object) -> Recording:
        opened.append(getattr(what, "name", ""))
        return real(recordings, what, **settings)  # type: ignore[arg-type]  # as given

    monkeypatch.setattr(Recordings, "open", spy)
    arguments = {
        "cut": ("cut", "-o", tmp_path / "out.mcap"),
        "download": ("download", "-o", tmp_path),
        "export": ("export", "--to", "csv", "-o", tmp_path / "out"),
    }[command]
    start = ("--start-time", "2024-01-01T00:00Z", "--topics", "/imu/data")
    assert klein(*arguments, "-m", mission, *start)[0] == 0
    assert sorted(opened) == ["damaged.mcap", "drive.mcap"]
    code, _, err = klein(*arguments, "-m", mission, "--start", "2031-01-01", "--dry-run")
    assert (code, len(opened)) == (3, 2)
    assert "nothing was recorded from 2031-01-01T00:00:00.000Z: the messages are from 2023-" in err
