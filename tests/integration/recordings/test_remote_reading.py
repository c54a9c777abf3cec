"""Recordings on the server are read in place through the SDK, by presigned ranges."""

import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.client import Client, connect
from kleinkram.client.files import RemoteFiles
from kleinkram.contract.errors import NotFound
from kleinkram.recordings import RawMessage, Recording, SourceError
from kleinkram.recordings.http_source import HttpSource
from kleinkram.recordings.sample import generate_db3, generate_mcap
from tests.integration.api_server import Api
from tests.integration.sample import Sample
from tests.integration.upload_client import upload

_SIZE = 12_000_000


@pytest.fixture(name="client")
def _client(api: Api) -> Iterator[Client]:
    with connect(api.url, api.token) as client:
        yield client


@pytest.fixture(name="drive", scope="module")
def _drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    generate_mcap(path, size_bytes=_SIZE, duration_s=12)
    return path


def _local(path: Path, *, start: int | None = None, end: int | None = None) -> list[RawMessage]:
    with Recording.open(path) as recording:
        return list(recording.raw_messages(start=start, end=end))


def _same(actual: list[RawMessage], expected: list[RawMessage]) -> bool:
    return [tuple(message[:5]) for message in actual] == [tuple(message[:5]) for message in expected]


def test_a_file_on_the_server_reads_as_it_does_locally(api: Api, client: Client, drive: Path) -> None:
    mission = api.mission(api.project()["id"])["id"]
    file_id = upload(api, mission, "drive.mcap", drive.read_bytes())["id"]
    with client.recordings.open(file_id) as recording:
        assert _same(list(recording.raw_messages()), _local(drive))
        assert not recording.problems
    with client.recordings.open("drive.mcap", mission=mission) as recording:
        assert recording.to_arrow("/imu/data").num_rows == recording.topic("/imu/data").count


def test_one_second_of_one_topic_fetches_little(api: Api, client: Client, drive: Path) -> None:
    mission = api.mission(api.project()["id"])["id"]
    file = upload(api, mission, "drive.mcap", drive.read_bytes())
    remote = RemoteFiles(client.files, [uuid.UUID(file["id"])])
    (source,) = remote.sources()
    recording = Recording.open(source)
    assert recording.start_ns is not None
    assert source.bytes_read < 100_000
    start = recording.start_ns + 5 * 10**9
    actual = list(recording.raw_messages("/gps/fix", start=start, end=start + 10**9))
    assert _same(actual, [m for m in _local(drive, start=start, end=start + 10**9) if m.topic == "/gps/fix"])
    assert source.bytes_read < _SIZE / 4
    remote.close()


def test_a_rosbag2_recording_is_opened_with_its_metadata(
    api: Api, client: Client, sample: Sample, tmp_path: Path
) -> None:
    truth = generate_db3(tmp_path / "drive", duration_s=1, size_bytes=500_000)
    mission = api.mission(api.project()["id"])["id"]
    ids = {
        path.suffix: upload(api, mission, f"drive/{path.name}", path.read_bytes())["id"]
        for path in (tmp_path / "drive").iterdir()
    }
    data = [ids[".db3"]]
    sample.recording(mission, "drive", data, kind="rosbag2")
    with client.recordings.open("drive", mission=mission) as recording:
        assert sum(1 for _ in recording.raw_messages()) == truth.message_count
        assert not recording.problems


def test_a_refused_address_is_renewed(api: Api, client: Client, drive: Path) -> None:
    mission = api.mission(api.project()["id"])["id"]
    file_id = uuid.UUID(upload(api, mission, "drive.mcap", drive.read_bytes())["id"])
    requested: list[uuid.UUID] = []

    def sign() -> str:
        requested.append(file_id)
        return client.files.links([file_id]).items[0].url

    bad = sign().replace("X-Amz-Signature=", "X-Amz-Signature=0")
    source = HttpSource(bad, size_bytes=drive.stat().st_size, name="drive.mcap", renew=sign)
    with Recording.open(source) as recording:
        assert _same(list(recording.raw_messages()), _local(drive))
    assert len(requested) == 2
    hopeless = HttpSource(bad, size_bytes=drive.stat().st_size, name="drive.mcap", renew=lambda: bad)
    with pytest.raises(SourceError, match="403"):
        Recording.open(hopeless)


def test_missing_recordings_are_not_found(client: Client) -> None:
    with pytest.raises(NotFound):
        client.recordings.open("no/such.mcap")
