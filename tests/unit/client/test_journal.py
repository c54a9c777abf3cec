"""What survives a kill -9."""

import os
import uuid
from pathlib import Path

import pytest

from kleinkram.client.errors import UploadElsewhere
from kleinkram.client.transfer.journal import Journal, JournalHead, JournalPart, journals_dir, open_journal
from kleinkram.client.transfer.plan import Identity, LocalFile

MISSION = uuid.UUID(int=1)
FILE = LocalFile(Path("/data/cam.mcap"), "day/cam.mcap", Identity(100, 1, 2, 3))


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def reopened() -> Journal:
    return open_journal("http://lab", MISSION, FILE)


def begun(*parts: JournalPart) -> uuid.UUID:
    journal = reopened()
    upload_id = uuid.uuid4()
    head = JournalHead(
        server="http://lab", mission_id=MISSION, path=FILE.path, source="", size_bytes=100, upload_id=upload_id
    )
    journal.begin(head, durable=True)
    for part in parts:
        journal.record(part)
    journal.close()
    return upload_id


def the_file() -> Path:
    (file,) = journals_dir().iterdir()
    return file


PART = JournalPart(number=1, checksum="ab", etag="cd")


def test_remembers_the_upload_and_its_parts() -> None:
    upload_id = begun(PART)
    remembered = reopened().remembered
    assert remembered is not None
    assert (remembered.upload_id, remembered.size_bytes, remembered.parts) == (upload_id, 100, {1: PART})


@pytest.mark.parametrize("cut", range(1, 40))
def test_a_torn_last_line_is_ignored_and_not_built_upon(cut: int) -> None:
    begun(PART, JournalPart(number=2, checksum="ef", etag="01"))
    os.truncate(the_file(), the_file().stat().st_size - cut)
    journal = reopened()
    assert journal.remembered is not None
    assert set(journal.remembered.parts) == {1}
    journal.record(JournalPart(number=3, checksum="23", etag="45"))
    journal.close()
    again = reopened().remembered
    assert again is not None
    assert set(again.parts) == {1, 3}


def test_a_torn_head_is_no_journal() -> None:
    begun()
    os.truncate(the_file(), 10)
    assert reopened().remembered is None


def test_rubbish_is_no_journal() -> None:
    begun(PART)
    the_file().write_bytes(b"\0" * 200 + b"\n")
    assert reopened().remembered is None


def test_another_upload_starts_it_anew() -> None:
    begun(PART)
    second = begun()
    remembered = reopened().remembered
    assert remembered is not None
    assert (remembered.upload_id, remembered.parts) == (second, {})


def test_two_never_share_one() -> None:
    journal = reopened()
    with pytest.raises(UploadElsewhere):
        reopened()
    journal.close()
    reopened().close()


def test_what_is_done_or_empty_leaves_nothing() -> None:
    begun(PART)
    reopened().forget()
    reopened().close()
    assert [*journals_dir().iterdir()] == []


def test_each_server_and_mission_has_its_own() -> None:
    journals = [
        open_journal("http://lab", MISSION, FILE),
        open_journal("http://other", MISSION, FILE),
        open_journal("http://lab", uuid.UUID(int=2), FILE),
    ]
    assert len([*journals_dir().iterdir()]) == 3
    for journal in journals:
        journal.close()
