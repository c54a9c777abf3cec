"""The journal of a transfer survives kill -9."""

import errno
import os
import uuid
from pathlib import Path

import pytest

from kleinkram.client.errors import UploadElsewhere
from kleinkram.client.transfer.journal import Journal, JournalHead, JournalPart, Journals, journals_dir
from kleinkram.client.transfer.plan import FileIdentity, LocalFile
from kleinkram.contract.uploads import MIN_PART_BYTES

MISSION = uuid.UUID(int=1)
FILE = LocalFile(Path("/data/cam.mcap"), "day/cam.mcap", FileIdentity(100, 1, 2, 3))


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def reopened(journals: Journals | None = None, file: LocalFile = FILE) -> Journal:
    return (journals or Journals()).open("http://lab", MISSION, file)


def head_of(upload_id: uuid.UUID) -> JournalHead:
    return JournalHead(
        server="http://lab", mission_id=MISSION, path=FILE.path, source="", size_bytes=100, upload_id=upload_id
    )


def begun(*parts: JournalPart) -> uuid.UUID:
    journal = reopened()
    upload_id = uuid.uuid4()
    journal.begin(head_of(upload_id), durable=True)
    for part in parts:
        journal.record(part)
    journal.close()
    return upload_id


def the_file() -> Path:
    (file,) = journals_dir().iterdir()
    return file


PART = JournalPart(number=1, checksum="ab", etag="cd")


def test_a_journal_stores_the_upload_and_its_parts() -> None:
    upload_id = begun(PART)
    remembered = reopened().remembered
    assert remembered is not None
    assert (remembered.upload_id, remembered.size_bytes, remembered.parts) == (upload_id, 100, {1: PART})


@pytest.mark.parametrize("cut", range(1, 40))
def test_a_torn_last_line_is_ignored_and_removed(cut: int) -> None:
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


def test_a_journal_with_a_torn_head_is_ignored() -> None:
    begun()
    os.truncate(the_file(), 10)
    assert reopened().remembered is None


def test_a_journal_with_invalid_content_is_ignored() -> None:
    begun(PART)
    the_file().write_bytes(b"\0" * 200 + b"\n")
    assert reopened().remembered is None


def test_another_upload_replaces_the_journal() -> None:
    begun(PART)
    second = begun()
    remembered = reopened().remembered
    assert remembered is not None
    assert (remembered.upload_id, remembered.parts) == (second, {})


def test_two_processes_never_share_a_journal() -> None:
    journal = reopened()
    with pytest.raises(UploadElsewhere):
        reopened()
    journal.close()
    reopened().close()


def test_finished_and_empty_journals_leave_no_file() -> None:
    begun(PART)
    journals = Journals()
    reopened(journals).forget()
    reopened(journals).close()
    journals.close()
    assert [*journals_dir().iterdir()] == []


def other(number: int, size_bytes: int = 100) -> LocalFile:
    return LocalFile(Path("/data/x"), f"{number}.bin", FileIdentity(size_bytes, 1, 2, 3))


def test_small_files_share_a_file_one_after_the_other() -> None:
    journals = Journals()
    inodes = set()
    for number in range(5):
        journal = reopened(journals, other(number))
        assert journal.remembered is None
        journal.begin(head_of(uuid.uuid4()), durable=False)
        journal.record(PART)
        inodes |= {path.stat().st_ino for path in journals_dir().iterdir()}
        with pytest.raises(UploadElsewhere):
            reopened(file=other(number))
        journal.forget()
    assert len(inodes) == 1
    journals.close()
    assert [*journals_dir().iterdir()] == []


def test_entries_of_a_shared_journal_remain_after_closing() -> None:
    journals = Journals()
    reopened(journals, other(1)).forget()
    journal, upload_id = reopened(journals, other(2)), uuid.uuid4()
    journal.begin(head_of(upload_id), durable=False)
    journal.close()
    journals.close()
    again = reopened(file=other(2)).remembered
    assert again is not None
    assert again.upload_id == upload_id
    assert len([*journals_dir().iterdir()]) == 1


def test_an_existing_journal_is_read_even_with_spare_files() -> None:
    upload_id = begun(PART)
    journals = Journals()
    reopened(journals, other(1)).forget()
    remembered = reopened(journals).remembered
    assert remembered is not None
    assert remembered.upload_id == upload_id


def test_spare_files_of_a_killed_process_are_removed_and_its_journals_remain() -> None:
    killed = Journals()
    for journal in [reopened(killed, other(number)) for number in range(3)]:
        journal.forget()
    journal = reopened(killed, other(3))
    journal.begin(head_of(uuid.uuid4()), durable=False)
    Journals().close()
    assert len([*journals_dir().iterdir()]) == 4, "they are of a process that lives"
    for handle in [journal._handle, *(handle for handle, _ in killed._spares._free)]:
        os.close(handle)
    Journals().close()
    assert len([*journals_dir().iterdir()]) == 2, "the journal, and the other name of its file"
    journals = Journals()
    resumed = reopened(journals, other(3))
    assert resumed.remembered is not None
    resumed.forget()
    journals.close()
    assert [*journals_dir().iterdir()] == []


def test_each_journal_has_its_own_file_where_hard_links_are_unavailable(monkeypatch: pytest.MonkeyPatch) -> None:
    def cannot(*_: object) -> None:
        raise PermissionError(errno.EPERM, "not this file system")

    monkeypatch.setattr(os, "link", cannot)
    journals = Journals()
    for number in range(5):
        reopened(journals, other(number)).forget()
    journals.close()
    assert [*journals_dir().iterdir()] == []


def test_a_large_file_gets_a_journal_of_its_own() -> None:
    journals = Journals()
    reopened(journals, other(1)).forget()
    large = reopened(journals, other(2, MIN_PART_BYTES + 1))
    assert large._own is None
    large.close()
    journals.close()


def test_each_server_and_mission_has_its_own_journal() -> None:
    journals = [
        Journals().open("http://lab", MISSION, FILE),
        Journals().open("http://other", MISSION, FILE),
        Journals().open("http://lab", uuid.UUID(int=2), FILE),
    ]
    assert len([*journals_dir().iterdir()]) == 3
    for journal in journals:
        journal.close()
