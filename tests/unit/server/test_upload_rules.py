import datetime
import uuid
from typing import Any

import pytest

from kleinkram.contract.errors import FileExists, NameLeased, PathConflict
from kleinkram.contract.uploads import UploadFile
from kleinkram.server.files.paths import conflicts_among
from kleinkram.server.uploads.completion import placement_of
from kleinkram.server.uploads.queries import ExistingFile, FileContent, UploadRow
from kleinkram.server.uploads.service import FileAction, RequestFacts, decide

_SHA = "ab" * 32
_OTHER = "cd" * 32
_PERSON = uuid.UUID("00000000-0000-4000-8000-000000000001")
_ID = uuid.UUID("0f0e0d0c-0b0a-4090-8070-605040302010")


def _facts(**changes: Any) -> RequestFacts:
    values: dict[str, Any] = {
        "person_id": _PERSON,
        "may_read": True,
        "files": {},
        "uploads": {},
        "duplicate_sizes": frozenset(),
        "duplicates": {},
        "conflicts": {},
    }
    return RequestFacts(**(values | changes))


def _existing(*, state: str = "verified", path: str = "run.mcap") -> ExistingFile:
    return ExistingFile(_ID, path, path, 10, bytes.fromhex(_SHA), state)


def _upload(*, has_lease: bool = True, state: str = "open") -> UploadRow:
    now = datetime.datetime(2026, 1, 1, tzinfo=datetime.timezone.utc)
    minute = datetime.timedelta(minutes=1)
    return UploadRow(
        id=_ID,
        mission_id=_ID,
        person_id=_PERSON,
        run_id=None,
        path="run.mcap",
        path_key="run.mcap",
        size_bytes=10,
        part_size_bytes=100,
        checksum="crc64nvme",
        store_id="main",
        key="a/b.mcap",
        multipart_id=None,
        signed_checksum=None,
        state=state,
        sha256=bytes.fromhex(_SHA),
        crc64nvme=bytes(8),
        file_id=None,
        failure=None,
        renewed_at=now,
        lease_ends_at=now + minute if has_lease else now - minute,
        expires_at=now + minute,
        now=now,
    )


def _requested(**changes: Any) -> UploadFile:
    return UploadFile.model_validate({"path": "run.mcap", "size_bytes": 10} | changes)


def test_an_upload_under_an_unused_name_begins() -> None:
    assert decide(_requested(), _facts()).action is FileAction.begin


def test_an_existing_name_requires_the_hash_first() -> None:
    assert decide(_requested(), _facts(files={"run.mcap": _existing()})).action is FileAction.hash_required


def test_the_same_content_under_the_same_name_is_present() -> None:
    decision = decide(_requested(sha256=_SHA), _facts(files={"run.mcap": _existing()}))
    assert (decision.action, decision.file_id) == (FileAction.present, _ID)


def test_other_content_under_the_same_name_is_refused_naming_both_hashes() -> None:
    error = decide(_requested(sha256=_OTHER), _facts(files={"run.mcap": _existing()})).error
    assert isinstance(error, FileExists)
    assert (error.existing_sha256, error.sent_sha256) == (_SHA, _OTHER)


@pytest.mark.parametrize("state", ["lost", "corrupt"])
def test_the_same_content_repairs_a_damaged_file(state: str) -> None:
    assert (
        decide(_requested(sha256=_SHA), _facts(files={"run.mcap": _existing(state=state)})).action is FileAction.begin
    )


@pytest.mark.parametrize("state", ["lost", "corrupt"])
def test_other_content_does_not_repair_a_damaged_file(state: str) -> None:
    facts = _facts(files={"run.mcap": _existing(state=state)})
    assert decide(_requested(sha256=_OTHER), facts).action is FileAction.refuse


def test_a_name_that_differs_only_in_case_is_a_conflict() -> None:
    error = decide(_requested(path="RUN.mcap"), _facts(files={"run.mcap": _existing()})).error
    assert isinstance(error, PathConflict)
    assert error.other == "run.mcap"


def test_a_name_under_lease_is_refused() -> None:
    error = decide(_requested(), _facts(uploads={"run.mcap": _upload(has_lease=True)})).error
    assert isinstance(error, NameLeased)


def test_an_expired_lease_is_stolen() -> None:
    decision = decide(_requested(), _facts(uploads={"run.mcap": _upload(has_lease=False)}))
    assert (decision.action, decision.stolen_upload_id) == (FileAction.begin, _ID)


def test_the_lease_of_an_upload_being_completed_is_never_stolen() -> None:
    decision = decide(_requested(), _facts(uploads={"run.mcap": _upload(has_lease=False, state="completing")}))
    assert decision.action is FileAction.refuse


def test_the_owner_of_a_lease_resumes() -> None:
    decision = decide(_requested(upload_id=_ID), _facts(uploads={"run.mcap": _upload(has_lease=True)}))
    assert (decision.action, decision.upload_id) == (FileAction.resume, _ID)


def test_another_size_does_not_resume() -> None:
    decision = decide(_requested(upload_id=_ID, size_bytes=11), _facts(uploads={"run.mcap": _upload(has_lease=True)}))
    assert decision.action is FileAction.refuse


def test_a_possible_duplicate_is_hashed_first_and_then_linked() -> None:
    blob_id = uuid.uuid4()
    facts = _facts(duplicate_sizes=frozenset({10}), duplicates={FileContent(10, bytes.fromhex(_SHA)): blob_id})
    assert decide(_requested(), facts).action is FileAction.hash_required
    linked = decide(_requested(sha256=_SHA), facts)
    assert (linked.action, linked.blob_id) == (FileAction.link, blob_id)
    assert decide(_requested(sha256=_OTHER), facts).action is FileAction.begin


def test_an_upload_of_another_person_is_not_resumed() -> None:
    facts = _facts(uploads={"run.mcap": _upload(has_lease=True)}, person_id=uuid.uuid4())
    assert decide(_requested(upload_id=_ID), facts).action is FileAction.refuse


@pytest.mark.parametrize(
    ("paths", "refused"),
    [
        (["a", "b", "c/d", "c/e"], {}),
        (["a", "A"], {1: "a"}),
        (["a", "a/b", "a/c", "d"], {1: "a", 2: "a"}),
        (["a/b/c", "a/b", "a"], {1: "a/b/c", 2: "a/b/c"}),
        (["Zu\u0308rich", "ZÜRICH/x"], {1: "Zu\u0308rich"}),
    ],
)
def test_the_earlier_of_two_conflicting_paths_wins(paths: list[str], refused: dict[int, str]) -> None:
    assert conflicts_among(paths) == refused


def test_a_completed_upload_becomes_a_new_file() -> None:
    placement = placement_of(_upload(), None, None, may_read=True)
    assert (placement.file_id, placement.needs_blob, placement.error) == (None, True, None)


def test_a_completed_upload_repairs_a_damaged_file() -> None:
    placement = placement_of(_upload(), _existing(state="lost"), None, may_read=True)
    assert (placement.file_id, placement.needs_blob, placement.error) == (_ID, True, None)


def test_a_completed_upload_leaves_a_sound_file_with_the_same_bytes() -> None:
    placement = placement_of(_upload(), _existing(), None, may_read=True)
    assert (placement.file_id, placement.needs_blob, placement.error) == (_ID, False, None)


def test_a_completed_upload_never_replaces_other_bytes() -> None:
    other = _existing()._replace(sha256=bytes.fromhex(_OTHER))
    error = placement_of(_upload(), other, None, may_read=False).error
    assert isinstance(error, FileExists)
    assert error.existing_sha256 is None, "hidden from an actor who may not read"
