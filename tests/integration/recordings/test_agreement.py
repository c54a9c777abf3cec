"""The server and the remote reader agree with `klein inspect` on every recording."""

import shutil
import uuid
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

from kleinkram.client import Client, connect
from kleinkram.contract.files import RecordingRead
from kleinkram.recordings import Content, NotARecording
from tests.conftest import MakeCase
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.recordings.test_readers_agree import CASE_NUMBERS, WITHOUT_RECORDINGS
from tests.integration.upload_client import upload_all
from tests.recording_files.agreement import Account, Accounts, Reading, accounts_of, disagreements, reading_of


def account_on_server(api: Api, recording: RecordingRead) -> Account:
    """Return what the server says of a recording and of its files."""
    files = [api.get(f"/files/{file_id}").ok() for file_id in recording.file_ids]
    topics: dict[str, tuple[str, int | None]] = {}
    for topic in (topic for file in files for topic in api.all(f"/files/{file['id']}/topics")):
        known_type, known = topics.get(topic["name"], (topic["message_type"], 0))
        count = None if known is None or topic["count"] is None else known + topic["count"]
        topics[topic["name"]] = (known_type, count)
    codes = {problem.code for problem in recording.problems}
    return Account(
        tuple(name for path in recording.paths if (name := PurePosixPath(path).name) != "metadata.yaml"),
        Content(recording.content.value),
        recording.message_count,
        (recording.start_ns, recording.end_ns),
        topics,
        frozenset(codes | {problem["code"] for file in files for problem in file["problems"]}),
    )


def read_from_server(client: Client, recording: RecordingRead) -> Reading | None:
    """Read all messages of a recording from the store; None where there are none that are read."""
    try:
        with client.recordings.open(recording) as opened:
            return reading_of(opened)
    except NotARecording:
        return None


def found_on_server(api: Api, mission_id: str, folder: Path) -> Mapping[str, list[str]]:
    """Return where the readers of the recordings of a mission disagree, those on the server among them."""
    local = {accounts.name: accounts for accounts in accounts_of(folder)}
    actual: dict[str, list[str]] = {}
    with connect(api.url, api.token) as client:
        recordings = {recording.name: recording for recording in client.recordings.list(uuid.UUID(mission_id))}
        assert recordings.keys() == local.keys()
        for name, recording in recordings.items():
            accounts: Accounts = replace(
                local[name], far=read_from_server(client, recording), server=account_on_server(api, recording)
            )
            if named := disagreements(accounts):
                actual[name] = named
    return actual


def test_the_server_agrees_with_all_readers_on_former_failures(
    api: Api, mission_id: str, make_case: MakeCase, tmp_path: Path
) -> None:
    """All of them are folders of one mission: its jobs run once."""
    for number in sorted(set(CASE_NUMBERS) - WITHOUT_RECORDINGS):
        shutil.copytree(make_case(number), tmp_path / number, ignore=shutil.ignore_patterns("printed.txt"))
    files = [path for path in sorted(tmp_path.rglob("*")) if path.is_file()]
    upload_all(api, mission_id, {path.relative_to(tmp_path).as_posix(): path.read_bytes() for path in files})
    run_jobs(api)
    assert found_on_server(api, mission_id, tmp_path) == {}
