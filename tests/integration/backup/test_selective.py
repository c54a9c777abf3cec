"""Restore one project, mission or file out of a backup into the instance that people use."""

import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from kleinkram.server.backup import selective
from kleinkram.server.backup.errors import BackupConflict, BackupError, BackupNotFound, BackupRequestInvalid
from kleinkram.server.backup.saved_rows import RestoreSelection
from kleinkram.server.backup.selective import SelectiveRestore, restore_selection
from kleinkram.server.maintenance import collect_garbage
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.backup.instances import (
    back_up,
    contents,
    delete_object,
    opened,
    settings_of,
    show_nothing,
    write_object,
)
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site, run_jobs
from tests.integration.upload_client import fetch, sha256, upload
from tests.klein import run_backup

NOTES = 'rain\tand\\n\nsnow \u2603 \\N {a,"b"}'
METADATA = {"weather": 'quoted "rain"\\n\n', "tags": 3}


class Saved(NamedTuple):
    """A project that is in the backup, its missions, and the folder of the backup."""

    project: Any
    missions: list[Any]
    place: Path


# Files of the missions of a project for each test. Equal bytes are in one project only.
_PROJECTS: dict[str, Sequence[dict[str, bytes]]] = {
    "a purged mission": [{"a b.bin": b"one", "folder/\u00e4.bin": b"two"}, {}],
    "a purged project": [{"a.bin": b"project 1"}, {"a.bin": b"project 2"}],
    "other bytes": [{"run/a.bin": b"old", "folder": b"a file", "b.bin": b"in the trash"}],
    "a lost file": [{"a.bin": b"alike"}, {}],
    "one file": [{"a.bin": b"not restored", "b.bin": b"restored"}],
    "bytes being deleted": [{"a.bin": b"being deleted"}],
    "a damaged backup": [{"good.bin": b"good", "long.bin": b"altered in the backup"}],
    "damaged bytes": [{"a.bin": b"intact"}],
    "an interruption": [{"a.bin": b"written"}, {"a.bin": b"not written"}],
    "refusals": [{"a.bin": b"refused"}],
    "the command": [{"a.bin": b"c"}],
}
# Uploaded when those above are verified: only then are equal bytes linked.
_LINKED = {
    "a purged mission": [{"copy.bin": b"one"}, {"kept.bin": b"two"}],
    "a lost file": [{}, {"b.bin": b"alike"}],
}


@pytest.fixture(name="lab", scope="module")
def _lab(start_api: StartApi) -> Api:
    """A server that deletes at once what is deleted."""
    return start_api(trash_days=0, garbage_grace_s=0, reverify_days=0)


@pytest.fixture(scope="module")
def owner(lab: Api) -> Api:
    """The person who owns all projects."""
    return lab.as_(people.person(lab).token)


@pytest.fixture(scope="module")
def saved(lab: Api, owner: Api, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Saved]:
    """The projects of all tests, in one backup."""
    place: Path = tmp_path_factory.mktemp("backup")
    projects = {}
    for name, missions in _PROJECTS.items():
        project = owner.project(description="two days")
        projects[name] = Saved(project, [owner.mission(project["id"]) for _ in missions], place)
        _upload_all(owner, projects[name], missions)
    mission = projects["a purged mission"].missions[0]
    lab.sql("UPDATE mission SET notes = %s, metadata = %s WHERE id = %s", NOTES, json.dumps(METADATA), mission["id"])
    run_jobs(lab)
    for name, missions in _LINKED.items():
        _upload_all(owner, projects[name], missions)
    labelled = _files(lab, mission["id"])["a b.bin"]
    lab.patch(f"/files/{labelled['id']}", {"labels": ["dusk {x}", 'quo"te']}).ok()
    run_jobs(lab)
    back_up(settings_of(lab), place)
    return projects


def _upload_all(owner: Api, saved: Saved, missions: Sequence[dict[str, bytes]]) -> None:
    for mission, files in zip(saved.missions, missions, strict=True):
        for path, body in files.items():
            upload(owner, mission["id"], path, body)


def _key(api: Api, mission: Any, path: str) -> str:
    """The object of a file."""
    query = "SELECT key FROM blob JOIN file ON file.blob_id = blob.id WHERE mission_id = %s AND path = %s"
    return str(api.sql(query, mission["id"], path)[0][0])


def _restore(api: Api, place: Path, project: str, *more: str | None, dry_run: bool = False) -> SelectiveRestore:
    selection = RestoreSelection(project, *more)
    return restore_selection(settings_of(api), opened(place, None), None, selection, show_nothing, is_dry_run=dry_run)


def _purge(api: Api) -> None:
    """Empty the trash, and delete the objects."""
    for _ in range(4):  # files, missions, projects; then objects
        on_site(api, collect_garbage)
    assert api.sql("SELECT count(*) FROM blob WHERE marked_for_deletion_at IS NOT NULL") == [(0,)]


def _files(api: Api, mission_id: str) -> dict[str, Any]:
    return {item["path"]: item for item in api.all("/files", {"mission_id": mission_id})}


def _content(api: Api, file_id: str) -> bytes:
    (signed,) = api.post("/files/download", {"file_ids": [file_id]}).ok()["items"]
    return fetch(signed["url"])[1]


def test_a_purged_mission_returns_with_ids_names_notes_metadata_and_bytes(lab: Api, saved: dict[str, Saved]) -> None:
    project, (mission, _), place = saved["a purged mission"]
    bodies = {"a b.bin": b"one", "folder/\u00e4.bin": b"two", "copy.bin": b"one"}
    before = _files(lab, mission["id"])
    lab.delete(f"/missions/{mission['id']}").ok()
    _purge(lab)
    lab.get(f"/missions/{mission['id']}").refused(404, "not_found")

    planned = _restore(lab, place, project["name"], mission["name"], dry_run=True)
    assert (planned.files, planned.copied_bytes, planned.created) == (3, 3, [f"mission {mission['name']}"])
    lab.get(f"/missions/{mission['id']}").refused(404, "not_found")

    done = _restore(lab, place, project["name"], mission["name"])
    assert (done.files, done.file_bytes, done.copied_bytes) == (3, 9, 3), "what another file has is not copied"
    read = lab.get(f"/missions/{mission['id']}").ok()
    assert (read["name"], read["notes"], read["metadata"]) == (mission["name"], NOTES, METADATA)
    after = _files(lab, mission["id"])
    assert {path: item["id"] for path, item in after.items()} == {path: item["id"] for path, item in before.items()}
    assert sorted(after["a b.bin"]["labels"]) == sorted(["dusk {x}", 'quo"te'])
    assert {path: _content(lab, item["id"]) for path, item in after.items()} == bodies
    run_jobs(lab)
    assert {item["state"] for item in _files(lab, mission["id"]).values()} == {"verified"}
    assert lab.get(f"/missions/{mission['id']}").ok()["file_count"] == 3

    (event,) = [one for one in lab.events(after["a b.bin"]["id"]) if one["operation"] == "file.restore"]
    assert (event["actor"], event["after"]["backup"]) == (None, done.snapshot.id)
    assert event["after"]["sha256"] == sha256(b"one")
    again = _restore(lab, place, project["id"], mission["id"])
    assert (again.files, again.present, again.copied_bytes, again.created) == (0, 3, 0, [])


def test_a_purged_project_returns_and_only_admins_see_it(lab: Api, owner: Api, saved: dict[str, Saved]) -> None:
    project, _, place = saved["a purged project"]
    lab.delete(f"/projects/{project['id']}").ok()
    _purge(lab)
    other = owner.project(name=project["name"])
    done = _restore(lab, place, project["id"])
    assert (done.files, len(done.created)) == (2, 3)
    read = lab.get(f"/projects/{project['id']}").ok()
    assert read["name"].startswith(f"{project['name']} (restored 20")
    assert (read["description"], read["id"] != other["id"]) == ("two days", True)
    owner.get(f"/projects/{project['id']}").refused(404, "not_found")


def test_other_bytes_at_the_path_stay_and_the_file_returns_in_a_folder(lab: Api, saved: dict[str, Saved]) -> None:
    project, (mission,), place = saved["other bytes"]
    old = _files(lab, mission["id"])
    for item in old.values():
        lab.delete(f"/files/{item['id']}").ok()
    upload(lab, mission["id"], "run/a.bin", b"new")
    upload(lab, mission["id"], "folder/inside", b"x")
    done = _restore(lab, place, project["name"], mission["name"])
    assert done.files == 3
    assert sorted(done.renamed) == ["folder", "run/a.bin"]
    bodies = {item["path"]: _content(lab, item["id"]) for item in _files(lab, mission["id"]).values()}
    assert (bodies["run/a.bin"], bodies[done.renamed["run/a.bin"]], bodies["b.bin"]) == (
        b"new",
        b"old",
        b"in the trash",
    )
    assert bodies[done.renamed["folder"]] == b"a file"
    ids = {item["id"] for item in _files(lab, mission["id"]).values()}
    assert old["run/a.bin"]["id"] not in ids, "the trash still has that id"
    again = _restore(lab, place, project["name"], mission["name"])
    assert (again.files, again.present) == (0, 3)


def test_a_lost_file_is_repaired_for_all_that_have_its_bytes(lab: Api, saved: dict[str, Saved]) -> None:
    project, (mission, _), place = saved["a lost file"]
    key = _key(lab, mission, "a.bin")
    lab.sql("UPDATE blob SET state = 'lost', damaged_at = now() WHERE key = %s", key)
    delete_object(settings_of(lab), key)
    done = _restore(lab, place, project["name"], mission["name"], "a.bin")
    assert (done.files, done.repaired, done.copied_bytes) == (0, 1, 5)
    assert contents(settings_of(lab))[key] == sha256(b"alike")
    run_jobs(lab)
    (file,) = _files(lab, mission["id"]).values()
    assert file["state"] == "verified"
    assert "file.repair" in [one["operation"] for one in lab.events(file["id"])]


def test_one_file_is_restored_alone(lab: Api, saved: dict[str, Saved]) -> None:
    project, (mission,), place = saved["one file"]
    for item in _files(lab, mission["id"]).values():
        lab.delete(f"/files/{item['id']}").ok()
    _purge(lab)
    assert _restore(lab, place, project["name"], mission["name"], "B.bin").files == 1
    assert [*_files(lab, mission["id"])] == ["b.bin"]


def test_a_file_whose_bytes_are_being_deleted_is_restored_later(lab: Api, saved: dict[str, Saved]) -> None:
    project, (mission,), place = saved["bytes being deleted"]
    key, (item,) = _key(lab, mission, "a.bin"), _files(lab, mission["id"]).values()
    lab.delete(f"/files/{item['id']}").ok()
    lab.sql("DELETE FROM file WHERE id = %s", item["id"])
    lab.sql("UPDATE blob SET marked_for_deletion_at = now() WHERE key = %s", key)
    early = _restore(lab, place, project["name"], mission["name"])
    assert (early.files, "are being deleted" in early.unavailable.first[0]) == (0, True)
    _purge(lab)
    later = _restore(lab, place, project["name"], mission["name"])
    assert (later.files, later.unavailable.count) == (1, 0)


def test_damaged_backups_restore_what_they_can(lab: Api, saved: dict[str, Saved], tmp_path: Path) -> None:
    project, (mission,), place = saved["a damaged backup"]
    damaged = shutil.copytree(place, tmp_path / "damaged")
    key = _key(lab, mission, "long.bin")
    (damaged / "objects" / key).write_bytes(b"altered in the backup!")
    lab.delete(f"/missions/{mission['id']}").ok()
    _purge(lab)
    done = _restore(lab, damaged, project["name"], mission["name"])
    assert (done.files, done.unavailable.count, "long.bin" in done.unavailable.first[0]) == (1, 1, True)
    assert [*_files(lab, mission["id"])] == ["good.bin"]
    assert "lost" not in contents(settings_of(lab)).values(), "no row without its object"


def test_damaged_bytes_of_the_instance_stay_if_the_backup_does_not_have_better_ones(
    lab: Api, saved: dict[str, Saved], tmp_path: Path
) -> None:
    project, (mission,), place = saved["damaged bytes"]
    damaged = shutil.copytree(place, tmp_path / "damaged")
    key = _key(lab, mission, "a.bin")
    (damaged / "objects" / key).unlink()
    lab.sql("UPDATE blob SET state = 'corrupt', damaged_at = now() WHERE key = %s", key)
    write_object(settings_of(lab), key, b"intacT")
    done = _restore(lab, damaged, project["name"])
    assert (done.repaired, done.unavailable.count) == (0, 1)
    assert contents(settings_of(lab))[key] == sha256(b"intacT")


def test_an_interrupted_restore_continues(lab: Api, saved: dict[str, Saved], monkeypatch: pytest.MonkeyPatch) -> None:
    project, _, place = saved["an interruption"]
    lab.delete(f"/projects/{project['id']}").ok()
    _purge(lab)
    write = selective._Restoration._write
    written: list[object] = []

    async def fail_later(self: Any, *arguments: Any) -> None:
        await write(self, *arguments)
        written.append(1)
        if len(written) == 2:
            raise BackupError("ended")

    monkeypatch.setattr(selective._Restoration, "_write", fail_later)
    with pytest.raises(BackupError, match="ended"):
        _restore(lab, place, project["name"])
    monkeypatch.setattr(selective._Restoration, "_write", write)
    done = _restore(lab, place, project["name"])
    assert (done.files, done.present, done.copied_bytes) == (1, 1, 0), "its object was copied before"
    assert len(lab.all("/files", {"project_id": project["id"]})) == 2


def test_what_cannot_be_restored_is_refused_with_a_sentence(lab: Api, api: Api, saved: dict[str, Saved]) -> None:
    project, (mission,), place = saved["refusals"]
    for more in (("no such",), (mission["name"], "no such")):
        with pytest.raises(BackupNotFound, match="no such"):
            _restore(lab, place, project["name"], *more)
    with pytest.raises(BackupNotFound, match="The backup has no project no such"):
        _restore(lab, place, "no such")
    with pytest.raises(BackupRequestInvalid, match="name its mission"):
        _restore(lab, place, project["name"], None, "a.bin")
    with pytest.raises(BackupConflict, match="of another instance"):
        _restore(api, place, project["name"])
    lab.delete(f"/missions/{mission['id']}").ok()
    with pytest.raises(BackupConflict, match=r"is in the trash.*klein trash restore"):
        _restore(lab, place, project["name"], mission["name"])


def test_the_command_prints_what_it_restored(lab: Api, saved: dict[str, Saved]) -> None:
    project, (mission,), place = saved["the command"]
    (item,) = _files(lab, mission["id"]).values()
    settings = settings_of(lab)
    lab.delete(f"/files/{item['id']}").ok()
    environment = {
        **os.environ,
        "KLEINKRAM_DATABASE_URL": str(settings.database_url),
        "KLEINKRAM_S3_INTERNAL_URL": settings.s3_internal_url,
        "KLEINKRAM_S3_BUCKET": settings.s3_bucket,
        "KLEINKRAM_S3_ACCESS_KEY": settings.s3_access_key,
        "KLEINKRAM_S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
    }

    def run(**more: object) -> "subprocess.CompletedProcess[str]":
        request = {"command": "restore", "location": str(place), "project": project["name"], **more}
        return run_backup(request, environment)

    planned = run(dry_run=True)
    assert (planned.returncode, "Would restore" in planned.stdout, "files: 1 (1 B" in planned.stdout) == (0, True, True)
    done = run(as_json=True)
    assert (done.returncode, json.loads(done.stdout)["files"]) == (0, 1)
    refused = run(mission="no such")
    assert (refused.returncode, "Traceback" in refused.stderr) == (3, False)
    assert (run(project=None, mission="x").returncode) == 2
