"""How each operation is called in the matrix: one row an operation, and the only place where that is said.

Every row must leave the world as it was: by asking for what changes nothing, for something new, or by its `undo`.
"""

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tests.integration.access.expecting import About, Verdict
from tests.integration.access.world import Asker, trash
from tests.integration.running import Answer, Api


@dataclass(frozen=True)
class Request:
    """One request to the API."""

    method: str
    path: str
    body: Any = None
    query: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Caller:
    """How to call an operation, what that is about, and how to read the answer.

    `shows`: of an operation that answers with whatever one may see: whether the thing is in it.
    `hides`: without the right, the thing is not even seen (404 where others say 403).
    `outcome`: how it went, of an answer that says so for each thing by itself.
    `is_boundless`: it is not about any place, so a credential that is limited to some is not for it.
    """

    request: Callable[[Asker], Request]
    about: About
    shows: Callable[[Any, Asker], bool] | None = None
    hides: bool = False
    outcome: Callable[[Any], int] | None = None
    is_boundless: bool = False
    undo: Callable[[Api, Asker], None] | None = None

    def verdict(self, answer: Answer) -> Verdict | int:
        """Return how it went."""
        status = answer.status
        if status == 200 and self.outcome is not None:
            status = self.outcome(answer.body)
        if status == 410 and self.hides:
            return Verdict.unseen
        return Verdict.of_status(status)


def _new() -> str:
    return f"new {uuid.uuid4()}"


def _get(path: str, /, **query: str) -> Callable[[Asker], Request]:
    return lambda by: Request("GET", _filled(path, by), query=tuple((k, _filled(v, by)) for k, v in query.items()))


def _delete(path: str, /, **query: str) -> Callable[[Asker], Request]:
    return lambda by: Request("DELETE", _filled(path, by), query=tuple(query.items()))


def _patch(path: str, body: Callable[[Asker], Any]) -> Callable[[Asker], Request]:
    return lambda by: Request("PATCH", _filled(path, by), body(by))


def _post(path: str, body: Callable[[Asker], Any] = lambda _: None) -> Callable[[Asker], Request]:
    return lambda by: Request("POST", _filled(path, by), body(by))


def _filled(text: str, by: Asker) -> str:
    return text.format(upload=by.upload, **vars(by.things))


def _lists(attribute: str) -> Callable[[Any, Asker], bool]:
    def shows(page: Any, by: Asker) -> bool:
        return getattr(by.things, attribute) in {item["id"] for item in page["items"]}

    return shows


def _outcome(answer: Any) -> int:
    """Read an upload's own status: gone for whoever may not see it; nothing was sent, for whoever may."""
    status: int = answer["items"][0]["problem"]["status"]
    return 200 if status == 409 else status


def _part(by: Asker) -> Any:
    return {"parts": [{"upload_id": by.upload, "number": 1, "checksum": "0" * 16}]}


def _unsign(api: Api, by: Asker) -> None:
    api.sql("UPDATE upload SET signed_checksum = NULL WHERE id = %s", by.upload)


def _finish(by: Asker) -> Any:
    return {"uploads": [{"upload_id": by.upload, "sha256": "0" * 64, "crc64nvme": "0" * 16}]}


def _trash_again(table: str, attribute: str) -> Callable[[Api, Asker], None]:
    return lambda api, by: trash(api, table, getattr(by.things, attribute))


def _set(statement: str, *attributes: str) -> Callable[[Api, Asker], None]:
    return lambda api, by: _run(api, statement, *(getattr(by.things, name) for name in attributes))


def _run(api: Api, statement: str, *values: Any) -> None:
    api.sql(statement, *values)


CALLERS: dict[str, tuple[Caller, ...]] = {
    "list_projects": (Caller(_get("/projects", name="{project_name}"), About.project, shows=_lists("project")),),
    "create_project": (Caller(_post("/projects", lambda _: {"name": _new()}), About.server, is_boundless=True),),
    "get_project": (Caller(_get("/projects/{project}"), About.project),),
    "update_project": (Caller(_patch("/projects/{project}", lambda _: {"description": ""}), About.project),),
    "delete_project": (Caller(_delete("/projects/{project}", dry_run="true"), About.project),),
    "get_mission_template": (Caller(_get("/projects/{project}/template"), About.project),),
    "create_mission": (Caller(_post("/projects/{project}/missions", lambda _: {"name": _new()}), About.project),),
    "list_missions": (Caller(_get("/missions", name="{mission_name}"), About.mission, shows=_lists("mission")),),
    "get_mission": (Caller(_get("/missions/{mission}"), About.mission),),
    "update_mission": (Caller(_patch("/missions/{mission}", lambda _: {"notes": ""}), About.mission),),
    "move_mission": (
        Caller(
            _patch("/missions/{mission}", lambda by: {"project_id": by.things.target}),
            About.mission,
            undo=_set("UPDATE mission SET project_id = %s WHERE id = %s", "project", "mission"),
        ),
    ),
    "delete_mission": (Caller(_delete("/missions/{mission}", dry_run="true"), About.mission),),
    "list_recordings": (Caller(_get("/missions/{mission}/recordings"), About.mission),),
    "get_recording": (Caller(_get("/recordings/{recording}"), About.file),),
    "list_files": (Caller(_get("/files", project_id="{project}"), About.file, shows=_lists("file")),),
    "get_file": (Caller(_get("/files/{file}"), About.file),),
    "download_files": (Caller(_post("/files/download", lambda by: {"file_ids": [by.things.file]}), About.file),),
    "list_file_topics": (Caller(_get("/files/{file}/topics"), About.file),),
    "prove_file": (Caller(_post("/files/{file}/prove"), About.file),),
    "update_file": (Caller(_patch("/files/{file}", lambda _: {"labels": []}), About.file),),
    "move_file": (
        Caller(
            _patch("/files/{file}", lambda by: {"mission_id": by.things.target_mission}),
            About.file,
            undo=_set("UPDATE file SET mission_id = %s WHERE id = %s", "mission", "file"),
        ),
    ),
    "delete_file": (Caller(_delete("/files/{file}", dry_run="true"), About.file),),
    "list_topics": (
        Caller(
            _get("/topics", project_id="{project}"),
            About.file,
            shows=lambda page, by: by.things.file in {item["file_id"] for item in page["items"]},
        ),
    ),
    "get_stats": (
        Caller(
            _get("/stats", project_id="{project}", path="one.mcap"),
            About.file,
            shows=lambda stats, _: stats["total"]["files"] > 0,
        ),
    ),
    "begin_uploads": (
        Caller(
            _post("/missions/{mission}/uploads", lambda _: {"files": [{"path": _new(), "size_bytes": 8}]}),
            About.mission,
        ),
    ),
    "list_uploads": (Caller(_get("/missions/{mission}/uploads"), About.mission),),
    "get_upload": (Caller(_get("/uploads/{upload}"), About.mission, hides=True),),
    "sign_parts": (Caller(_post("/uploads/parts", _part), About.mission, hides=True, undo=_unsign),),
    "complete_uploads": (
        Caller(
            _post("/uploads/complete", _finish),
            About.mission,
            hides=True,
            outcome=_outcome,
        ),
    ),
    "abort_upload": (
        Caller(
            _delete("/uploads/{upload}"),
            About.mission,
            hides=True,
            undo=lambda api, by: _run(api, "UPDATE upload SET state = 'open' WHERE id = %s", by.upload),
        ),
    ),
    "list_trash": (Caller(_get("/trash"), About.mission, shows=_lists("trashed_mission")),),
    "restore_from_trash": (
        Caller(
            _post("/trash/mission/{trashed_mission}/restore"),
            About.mission,
            hides=True,
            undo=_trash_again("mission", "trashed_mission"),
        ),
        Caller(
            _post("/trash/file/{trashed_file}/restore"),
            About.mission,
            hides=True,
            undo=_trash_again("file", "trashed_file"),
        ),
        Caller(
            _post("/trash/project/{trashed_project}/restore"),
            About.project,
            hides=True,
            undo=_trash_again("project", "trashed_project"),
        ),
    ),
    "list_audit_events": (
        Caller(_get("/audit", project_id="{project}"), About.project, shows=lambda page, _: bool(page["items"])),
    ),
    "get_service": (Caller(_get("/service"), About.server),),
}
