"""The SDK on a real server: names, keyword arguments, lists, transfers, pickled handles."""

import datetime
import inspect
import multiprocessing
import pickle
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from pydantic import ValidationError

import kleinkram
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.tokens import Reach
from kleinkram.contract.access import Right, TokenKind
from kleinkram.contract.errors import KleinkramError, MetadataInvalid, NotFound
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import Faults, SampleFormat, generate_mission
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs

START_NS = 1_714_550_400 * 10**9


@pytest.fixture(scope="module")
def client(api: Api) -> Iterator[Client]:
    with kleinkram.connect(api.url, api.token) as connected:
        yield connected


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sample") / "drive"
    generate_mission(folder, size_bytes=2_000_000, seed=3, formats=[SampleFormat.mcap], faults=Faults())
    (folder / "notes.txt").write_text("nothing")
    return folder


@pytest.fixture(scope="module")
def place(client: Client, api: Api, drive: Path) -> tuple[str, str]:
    """A project, and its mission with one recording whose content is known."""
    project = client.projects.create(f"sdk-{uuid.uuid4().hex[:8]}").name
    report = client.upload(
        drive, "ridge", project=project, create=True, metadata={"robot": "anymal"}, exclude=["*.txt"]
    )
    assert [result.path for result in report.results] == ["drive/drive.mcap"]
    run_jobs(api)
    return project, "ridge"


def test_uploading_and_downloading_take_one_line_each(
    client: Client, place: tuple[str, str], drive: Path, tmp_path: Path
) -> None:
    project, mission = place
    again = client.upload([drive], f"{project}/{mission}", exclude=["notes.*"])
    assert [result.outcome.value for result in again.results] == ["already_present"]
    client.download(dest=tmp_path, project=project, mission=mission)
    assert (tmp_path / "drive" / "drive.mcap").read_bytes() == (drive / "drive.mcap").read_bytes()
    client.download(client.missions.get(f"{project}/{mission}"), tmp_path / "nested", nested=True)
    assert (tmp_path / "nested" / project / mission / "drive" / "drive.mcap").is_file()
    with pytest.raises(NotFound):
        client.upload(drive, "nowhere", project=project)
    with pytest.raises(NothingToDo):
        client.download(project=project, topic="/none")
    with pytest.raises(NothingToDo):
        client.download()


def test_methods_of_the_sdk_accept_names_instead_of_ids(client: Client, place: tuple[str, str]) -> None:
    project, mission = place
    ref = f"{project}/{mission}"
    assert client.missions.update(ref, notes="seen").notes == "seen"
    assert client.missions.topics(ref, bins=0).items
    assert [row.path for row in client.missions.timeline(ref)] == ["drive/drive.mcap"]
    assert [row.name for row in client.recordings.list(mission, project=project)] == ["drive/drive.mcap"]
    assert client.projects.update(project, description="x").description == "x"
    assert client.stats.overview(project=project).total.files == 1
    file = client.files.get("drive/drive.mcap", mission=ref)
    assert [*client.files.topics(file)] == [*client.files.topics(str(file.id))]
    assert client.missions.delete(ref, dry_run=True).files == 1
    assert client.runs.count(project=project, mission=ref, state="failed") == 0
    with pytest.raises(NotFound):
        client.missions.update(f"{project}/none", notes="")


def test_a_mission_with_its_project_is_one_name_in_filters_too(client: Client, place: tuple[str, str]) -> None:
    project, mission = place
    other = client.projects.create(f"sdk-{uuid.uuid4().hex[:8]}").name
    client.missions.create(mission, project=other)
    assert client.files.count(mission=f"{project}/{mission}") == 1
    assert client.files.count(mission=f"{other}/{mission}") == 0
    assert client.runs.count(project=project, mission=mission) == 0, "which of the two is meant is known"
    assert client.runs.count(mission=f"{project}/{mission}") == 0
    with pytest.raises(InvalidInput, match="with project="):
        client.files.list(mission=[f"{project}/{mission}", f"{other}/{mission}"])


def test_an_empty_choice_is_not_everything(client: Client, place: tuple[str, str], tmp_path: Path) -> None:
    calls: list[Callable[[], object]] = [
        lambda: client.files.list(project=[]),
        lambda: client.missions.list(topic=[]),
        lambda: client.runs.list(mission=[]),
        lambda: client.download(dest=tmp_path, mission=[]),
    ]
    for ask in calls:
        with pytest.raises(InvalidInput, match="it names none"):
            ask()


def test_downloads_accept_ids_objects_or_lists(client: Client, place: tuple[str, str], tmp_path: Path) -> None:
    (file,) = client.files.list(project=place[0])
    several = client.files.list(project=place[0])
    for what in (file, file.id, str(file.id), [file.id], several, client.missions.list(project=place[0])):
        (result,) = client.download(what, tmp_path).results
        assert result.file_id == file.id
    not_a_file: Any = 5
    with pytest.raises(InvalidInput):
        client.download(not_a_file, tmp_path)


def test_one_glob_may_be_excluded_and_limits_must_let_something_through(
    client: Client, place: tuple[str, str], drive: Path, tmp_path: Path
) -> None:
    where = "/".join(place)
    assert [result.path for result in client.upload(drive, where, exclude="*.txt").results] == ["drive/drive.mcap"]
    with pytest.raises(InvalidInput, match="at least 1"):
        client.upload(drive, where, connections=0)
    with pytest.raises(InvalidInput, match="above zero"):
        client.download(client.missions.get(where), tmp_path, bytes_per_s=0)


def test_groups_people_links_and_tokens_go_by_name_as_well(client: Client, place: tuple[str, str]) -> None:
    project, mission = place
    me, name = client.me.get(), uuid.uuid4().hex[:8]
    group = client.groups.create(f"field-{name}")
    assert client.groups.set_member(f"FIELD-{name}", me.person.name, is_editor=True).person.id == me.person.id
    assert [row.person.id for row in client.groups.members(group)] == [me.person.id]
    renamed = client.groups.rename(group.name, f"crew-{name}")

    where = client.projects.get(project)
    client.access.grant(where, renamed.name, Right.read)
    client.access.revoke(where, renamed.name)
    assert renamed.name not in [grant.to.name for grant in client.access.grants(where)]
    client.groups.delete(renamed.name)
    with pytest.raises(NotFound):
        client.groups.get(renamed.name)

    ends = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=1)
    file = client.files.list(project=project, mission=mission)
    share = client.shares.create(f"{project}/{mission}", name, expires_at=ends, file_ids=[next(file)])
    assert [row.id for row in client.shares.list(mission_id=f"{project}/{mission}")] == [share.share.id]
    client.shares.revoke(name)

    made = client.tokens.create(f"robot-{name}", kind=TokenKind.robot, reach=Reach(project_ids=[project]))
    client.tokens.revoke(made.token.name)
    with pytest.raises(NotFound):
        client.tokens.get(made.token.name)


def test_filters_are_keyword_arguments(client: Client, place: tuple[str, str]) -> None:
    project, mission = place
    other = client.projects.create(f"{project}-2").name
    client.missions.create("empty", project=other)
    by_topic = client.files.list(project=project, topic="*imu*", recorded_after=START_NS)
    assert [file.path for file in by_topic] == ["drive/drive.mcap"]
    assert client.files.count(project=[project, other], mission=mission) == 1
    assert client.files.count("format:mcap", project=project) == 1
    assert client.files.count(project=project, recorded_before="2000-01-01") == 0
    assert client.files.count(project=project, min_size_bytes="1GB") == 0
    assert {row.name for row in client.missions.list(project=[project, other])} == {mission, "empty"}
    assert [row.name for row in client.missions.list(project=other, name=["emp*", "x"])] == ["empty"]
    assert [topic.file_count for topic in client.files.topics_found(project=project, topic="/imu/data")] == [1]
    assert client.stats.get("metadata.robot", project=project).rows[0].group == "anymal"


def test_lists_become_frames_and_tables_of_notebooks(client: Client, place: tuple[str, str]) -> None:
    project, _ = place
    files = client.files.list(project=project)
    frame = files.to_pandas()
    assert frame.loc[0, "mission.project.name"] == project
    assert isinstance(frame.loc[0, "created_at"], pd.Timestamp)
    assert str(frame["start_ns"].dtype) == "Int64"
    assert client.missions.list(project=project).to_pandas().loc[0, "metadata.robot"] == "anymal"
    lists: list[Any] = [client.projects.list(name=project), files, client.files.find_topics(project=project)]
    lists += [client.runs.list(project=project), client.runs.findings(project=project)]
    lists += [client.runs.metrics(project=project), client.recordings.list(f"{project}/ridge")]
    for rows in lists:
        assert rows.to_pandas().shape[0] == len([*rows])
        assert "<table>" in rows._repr_html_()
    assert "drive/drive.mcap" in files._repr_html_()
    assert len([*files]) == 1  # showing a list does not use it up
    assert next(files).path == "drive/drive.mcap"


def _read(recording: Recording, pipe: Any) -> None:
    with recording:
        pipe.send([message.stamp_ns for message in recording.messages("/imu/data")][:3])


def test_handles_are_pickled_and_reconnect_in_another_process(client: Client, place: tuple[str, str]) -> None:
    project, mission = place
    opened = client.recordings.open("drive/drive.mcap", mission=mission, project=project)
    with opened:
        stamps = [message.stamp_ns for message in opened.messages("/imu/data")][:3]
        receiver, sender = multiprocessing.Pipe(duplex=False)
        process = multiprocessing.get_context("spawn").Process(target=_read, args=(opened, sender))
        process.start()
        assert receiver.poll(60)
        assert receiver.recv() == stamps
        process.join(60)
    assert all(isinstance(stamp, int) for stamp in stamps)
    again: Client = pickle.loads(pickle.dumps(client))
    assert again.projects.get(project).name == project
    assert pickle.loads(pickle.dumps(client.files)).count(project=project) == 1


def test_a_frame_of_messages_is_indexed_by_time(client: Client, place: tuple[str, str]) -> None:
    project, mission = place
    with client.recordings.open("drive/drive.mcap", mission=mission, project=project) as recording:
        frame = recording.to_pandas("/imu/data")
        assert isinstance(frame.index, pd.DatetimeIndex)
        assert str(frame.index.dtype) == "datetime64[ns, UTC]"
        assert frame.index[0].value == frame["log_time_ns"].iloc[0]
        middle_ns = int(frame["log_time_ns"].iloc[5])
        at = datetime.datetime.fromtimestamp(middle_ns / 1e9, datetime.timezone.utc)
        counts = [len(recording.to_pandas("/imu/data", start=time)) for time in (middle_ns, frame.index[5])]
        assert counts == [len(frame) - 5] * 2
        assert len(recording.to_pandas("/imu/data", start=at.isoformat())) in range(len(frame) - 6, len(frame) - 3)


WRONG: tuple[Any, ...] = (object(), -1, "", "\x00", "a/b/c", [], {"a": 1}, float("nan"), "x" * 5000)


def _methods(client: Client) -> Iterator[tuple[str, Callable[..., object], list[inspect.Parameter]]]:
    left_out = {
        "runners",
        "uploads",
        "me",
        "admin",
        "service",
        "events",
    }  # for machines, or without arguments to get wrong
    for resource_type in sorted({*Client.__annotations__} - left_out):
        value = getattr(client, resource_type)
        for name, method in inspect.getmembers(value, inspect.ismethod):
            if not name.startswith("_"):
                yield f"{resource_type}.{name}", method, [*inspect.signature(method).parameters.values()]


def test_wrong_arguments_raise_plain_messages(client: Client) -> None:
    messages: dict[str, str] = {}
    tried = 0
    for name, method, parameters in _methods(client):
        needed = [
            result
            for result in parameters
            if result.default is result.empty and result.kind is result.POSITIONAL_OR_KEYWORD
        ]
        for wrong in WRONG:
            try:
                result = method(*[wrong for _ in needed])
                if isinstance(result, Iterator):
                    next(iter(result), None)
            except ValidationError as error:
                pytest.fail(f"client.{name}({wrong!r}) shows pydantic's words: {error}")
            except KleinkramError as error:
                messages[f"{name}({str(wrong)[:20]!r})"] = str(error)
            except (TypeError, AttributeError, ValueError):
                pass  # Python's own words for an argument of a wrong type
            tried += 1
    assert tried > 200
    shown = {call: words for call, words in messages.items() if "pydantic" in words or "Input should be" in words}
    assert shown == {}


def test_unknown_keywords_and_values_are_named(client: Client) -> None:
    files: Any = client.files
    for fields, words in (
        ({"topc": "/imu"}, "topc"),
        ({"state": "prooven"}, "one of"),
        ({"recorded_after": "yesterday"}, "2026-05-01"),
        ({"project": 7}, "name, its id"),
        ({"min_size_bytes": "big"}, "GB"),
    ):
        with pytest.raises(InvalidInput, match=words):
            files.list(**fields)
    with pytest.raises((InvalidInput, MetadataInvalid)):
        client.missions.create("x\x00", project=client.projects.create(f"wrong-{uuid.uuid4().hex[:6]}"))
