import uuid
from types import SimpleNamespace
from typing import Any

import pytest

from kleinkram.contract.errors import FileExists, NameLeased, PathConflict
from kleinkram.contract.uploads import UploadFile
from kleinkram.server.uploads.rules import Known, Way, decide, first_come

_SHA = "ab" * 32
_OTHER = "cd" * 32
_PERSON = uuid.UUID("00000000-0000-4000-8000-000000000001")
_ID = uuid.UUID("0f0e0d0c-0b0a-4090-8070-605040302010")


def _known(**changes: Any) -> Known:
    values: dict[str, Any] = {
        "person_id": _PERSON,
        "may_read": True,
        "files": {},
        "uploads": {},
        "twin_sizes": frozenset(),
        "twins": {},
        "conflicts": {},
    }
    return Known(**(values | changes))


def _existing(*, state: str = "verified", path: str = "run.mcap") -> Any:
    return SimpleNamespace(id=_ID, path=path, size_bytes=10, sha256=bytes.fromhex(_SHA), state=state)


def _active(*, leased: bool, state: str = "open") -> Any:
    ends = SimpleNamespace(isoformat=lambda timespec: "2026-01-01T00:00:00+00:00")
    return SimpleNamespace(
        id=_ID, person_id=_PERSON, path="run.mcap", size_bytes=10, state=state, leased=leased, lease_ends_at=ends
    )


def _wanted(**changes: Any) -> UploadFile:
    return UploadFile.model_validate({"path": "run.mcap", "size_bytes": 10} | changes)


def test_an_unknown_name_begins() -> None:
    assert decide(_wanted(), _known()).way is Way.begin


def test_a_name_that_exists_wants_the_hash_first() -> None:
    assert decide(_wanted(), _known(files={"run.mcap": _existing()})).way is Way.hash_first


def test_the_same_content_under_the_same_name_is_present() -> None:
    decision = decide(_wanted(sha256=_SHA), _known(files={"run.mcap": _existing()}))
    assert (decision.way, decision.ref) == (Way.present, _ID)


def test_other_content_under_the_same_name_is_refused_naming_both_hashes() -> None:
    error = decide(_wanted(sha256=_OTHER), _known(files={"run.mcap": _existing()})).error
    assert isinstance(error, FileExists)
    assert (error.existing_sha256, error.sent_sha256) == (_SHA, _OTHER)


@pytest.mark.parametrize("state", ["lost", "corrupt"])
def test_the_same_content_mends_a_file_whose_bytes_are_gone(state: str) -> None:
    assert decide(_wanted(sha256=_SHA), _known(files={"run.mcap": _existing(state=state)})).way is Way.begin


@pytest.mark.parametrize("state", ["lost", "corrupt"])
def test_other_content_mends_nothing(state: str) -> None:
    known = _known(files={"run.mcap": _existing(state=state)})
    assert decide(_wanted(sha256=_OTHER), known).way is Way.refuse


def test_a_name_that_differs_only_in_case_is_a_conflict() -> None:
    error = decide(_wanted(path="RUN.mcap"), _known(files={"run.mcap": _existing()})).error
    assert isinstance(error, PathConflict)
    assert error.other == "run.mcap"


def test_a_name_under_lease_is_refused() -> None:
    error = decide(_wanted(), _known(uploads={"run.mcap": _active(leased=True)})).error
    assert isinstance(error, NameLeased)


def test_a_lapsed_lease_is_taken_over() -> None:
    decision = decide(_wanted(), _known(uploads={"run.mcap": _active(leased=False)}))
    assert (decision.way, decision.takes_over) == (Way.begin, _ID)


def test_an_upload_that_is_being_finished_is_never_taken_over() -> None:
    decision = decide(_wanted(), _known(uploads={"run.mcap": _active(leased=False, state="completing")}))
    assert decision.way is Way.refuse


def test_its_own_client_resumes_under_the_lease() -> None:
    decision = decide(_wanted(upload_id=_ID), _known(uploads={"run.mcap": _active(leased=True)}))
    assert (decision.way, decision.ref) == (Way.resume, _ID)


def test_another_size_does_not_resume() -> None:
    decision = decide(_wanted(upload_id=_ID, size_bytes=11), _known(uploads={"run.mcap": _active(leased=True)}))
    assert decision.way is Way.refuse


def test_a_size_with_a_twin_is_hashed_first_and_then_linked() -> None:
    twin = uuid.uuid4()
    known = _known(twin_sizes=frozenset({10}), twins={(10, bytes.fromhex(_SHA)): twin})
    assert decide(_wanted(), known).way is Way.hash_first
    linked = decide(_wanted(sha256=_SHA), known)
    assert (linked.way, linked.ref) == (Way.link, twin)
    assert decide(_wanted(sha256=_OTHER), known).way is Way.begin


def test_somebody_elses_upload_is_not_resumed() -> None:
    known = _known(uploads={"run.mcap": _active(leased=True)}, person_id=uuid.uuid4())
    assert decide(_wanted(upload_id=_ID), known).way is Way.refuse


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
def test_of_paths_that_exclude_each_other_the_first_comes_in(paths: list[str], refused: dict[int, str]) -> None:
    assert first_come(paths) == refused
