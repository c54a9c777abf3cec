"""Presigned URLs allow exactly one operation, and for a short time (decision 13)."""

import datetime
import os
import uuid
from collections.abc import Callable
from pathlib import Path

import pytest
import urllib3

from kleinkram.client import connect
from kleinkram.client.transfer import Outcome, TransferResult, download, plan_download
from kleinkram.client.transfer.report import Watcher
from kleinkram.contract.access import Right
from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import FileFilter
from kleinkram.server.settings import Settings
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.people import Person
from tests.integration.upload_client import begin, complete, fetch, put, sign, upload, wait_until

# Expiries have whole seconds, so a URL may expire up to one second earlier.
_SHORT_S, _LONGEST_S = 2, 900
_POOL = urllib3.PoolManager(retries=False, timeout=30)


@pytest.fixture(name="brief", scope="module")
def _brief(start_api: StartApi) -> Api:
    """An API whose signed URLs expire soon."""
    return start_api(download_url_s=_SHORT_S)


def _mission(api: Api, right: Right) -> tuple[str, Person]:
    """Create a mission, and a person with a right on its project."""
    project_id, who = api.project()["id"], people.person(api)
    people.grant(api, who, right, project_id=project_id)
    return str(api.mission(project_id)["id"]), who


def _withdraw(api: Api, who: Person) -> None:
    api.sql("DELETE FROM access_grant WHERE group_id = %s", who.group_id)


def _link(api: Api, file: dict[str, str]) -> str:
    return str(api.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0]["url"])


def test_signed_urls_have_the_configured_lifetime() -> None:
    for name in ("download_url_s", "part_url_s"):
        assert Settings.model_fields[name].default <= _LONGEST_S, "decision 13 says how long, and why"


def test_a_signed_url_only_allows_reading_one_object(api: Api, mission_id: str) -> None:
    mine, other = (upload(api, mission_id, name, name.encode()) for name in ("mine", "other"))
    actual = api.sql("SELECT path, key FROM file JOIN blob ON blob.id = blob_id WHERE mission_id = %s", mission_id)
    keys = {str(path): str(key) for path, key in actual}
    url = _link(api, mine)
    assert fetch(url) == (200, b"mine")
    assert fetch(url.replace(keys["mine"], keys["other"]))[0] == 403
    for method in ("PUT", "POST", "DELETE"):
        assert _POOL.request(method, url, body=b"evil").status in {400, 403, 405}, method
    bucket = url.partition(f"/{keys['mine']}")[0]
    assert fetch(bucket)[0] == 403, "nor does it list"
    assert fetch(_link(api, mine))[1] == b"mine"
    assert fetch(_link(api, other))[1] == b"other"


def test_the_url_of_a_part_accepts_only_that_part(api: Api, mission_id: str) -> None:
    body = os.urandom(1000)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    signed = sign(api, started, [(1, body)]).ok()["items"][0]
    for other in (body[:-1], body + b"!"):
        of_its_length = {**signed["headers"], "Content-Length": str(len(other))}
        assert put(signed, other, of_its_length) in {400, 403}
    assert fetch(signed["url"])[0] == 403, "nor can it be read with that"
    assert put(signed, body) == 200


def test_signed_urls_expire_soon_after_the_right_was_revoked(brief: Api) -> None:
    mission_id, partner = _mission(brief, Right.read)
    expected = {"file_ids": [upload(brief, mission_id, "run.bin", b"secret")["id"]]}
    theirs = brief.as_(partner.token)
    answer = theirs.post("/files/download", expected).ok()["items"][0]
    _withdraw(brief, partner)
    theirs.post("/files/download", expected).refused(404, "not_found")
    wait_until(lambda: fetch(answer["url"])[0] == 403, limit_s=_SHORT_S + 5)
    text = datetime.datetime.fromisoformat(answer["expires_at"]) - datetime.timedelta(seconds=1)
    assert text <= datetime.datetime.now(datetime.timezone.utc), "not before it said"


def test_an_upload_completed_after_the_right_was_revoked_creates_no_file(api: Api) -> None:
    mission_id, partner = _mission(api, Right.create)
    theirs, body = api.as_(partner.token), b"too late"
    started = begin(theirs, mission_id, {"run.bin": body})[0]["upload"]
    signed = sign(theirs, started, [(1, body)]).ok()["items"][0]
    _withdraw(api, partner)
    assert put(signed, body) == 200, "the store knows nothing of rights"
    assert complete(theirs, started, body)["problem"]["code"] == "upload_gone"
    assert api.all("/files", {"mission_id": mission_id}) == []


class _Midway(Watcher):
    """Calls a function once, when the first bytes of a transfer have arrived."""

    def __init__(self, act: Callable[[], object]) -> None:
        self._act = act
        self._acted = False

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Call the function, the first time only."""
        if not self._acted:
            self._acted = True
            self._act()


@pytest.fixture(name="large", scope="module")
def _large() -> bytes:
    """A file that is too large to download with one URL at the rate below."""
    return os.urandom(20 * 1024 * 1024)


def _download(api: Api, who: Person, mission_id: str, dest: Path, act: Callable[[], object]) -> TransferResult:
    with connect(api.url, who.token) as client:
        plan = plan_download(client.files.list(FileFilter(mission_id=uuid.UUID(mission_id))), dest)
        pace = 4 * 1024 * 1024
        report = download(client, plan, connections=1, bytes_per_s=pace, watcher=_Midway(act))
        return report.results[0]


def test_a_long_download_renews_expired_urls(brief: Api, tmp_path: Path, large: bytes) -> None:
    mission_id, partner = _mission(brief, Right.read)
    file = upload(brief, mission_id, "run.bin", large)
    result = _download(brief, partner, mission_id, tmp_path, lambda: None)
    assert (result.outcome, result.error) == (Outcome.downloaded, None)
    assert (tmp_path / "run.bin").read_bytes() == large
    operations = [event["operation"] for event in brief.events(file["id"])]
    assert operations.count("file.download") > 1, "each address given out is in the record"


def test_a_download_ends_when_the_right_is_revoked(brief: Api, tmp_path: Path, large: bytes) -> None:
    mission_id, partner = _mission(brief, Right.read)
    upload(brief, mission_id, "run.bin", large)
    result = _download(brief, partner, mission_id, tmp_path, lambda: _withdraw(brief, partner))
    assert (result.outcome, type(result.error)) == (Outcome.refused, NotFound)
    assert not (tmp_path / "run.bin").exists()
