"""How the matrix calls each operation on projects, missions, files, uploads, the trash and the audit log."""

import random
from collections.abc import Callable
from typing import Any

from tests.integration.access.call import Caller, delete, get, has_items, lists, new_name, patch, post, sets
from tests.integration.access.expectations import About
from tests.integration.access.world import Principal, trash


def _outcome(answer: Any) -> int:
    """Read the status of an upload: missing for callers who may not see it; nothing was sent, for the others."""
    status: int = answer["items"][0]["problem"]["status"]
    return 200 if status == 409 else status


def _part(by: Principal) -> Any:
    return {"parts": [{"upload_id": by.upload, "number": 1, "checksum": "0" * 16}]}


def _unsign(by: Principal) -> None:
    by.api.sql("UPDATE upload SET signed_checksum = NULL WHERE id = %s", by.upload)


def _finish(by: Principal) -> Any:
    return {"uploads": [{"upload_id": by.upload, "sha256": "0" * 64, "crc64nvme": "0" * 16}]}


def _trash_again(table: str, attribute: str) -> Callable[[Principal], None]:
    return lambda by: trash(by.api, table, getattr(by.objects, attribute))


OF_THINGS: dict[str, tuple[Caller, ...]] = {
    "list_projects": (Caller(get("/projects", name="{project_name}"), About.project, shows=lists("project")),),
    "create_project": (Caller(post("/projects", lambda _: {"name": new_name()}), About.server, is_boundless=True),),
    "get_project": (Caller(get("/projects/{project}"), About.project),),
    "update_project": (Caller(patch("/projects/{project}", lambda _: {"description": ""}), About.project),),
    "publish_project": (
        Caller(patch("/projects/{project}", lambda _: {"citation": new_name()}), About.project, via="update_project"),
    ),
    "set_project_quota": (
        Caller(
            patch("/projects/{project}", lambda _: {"quota_files": random.randrange(10**6, 10**9)}),
            About.project,
            via="update_project",
        ),
    ),
    "delete_project": (Caller(delete("/projects/{project}", dry_run="true"), About.project),),
    "get_mission_template": (Caller(get("/projects/{project}/template"), About.project),),
    "create_mission": (Caller(post("/projects/{project}/missions", lambda _: {"name": new_name()}), About.project),),
    "list_missions": (Caller(get("/missions", name="{mission_name}"), About.mission, shows=lists("mission")),),
    "get_mission": (Caller(get("/missions/{mission}"), About.mission),),
    "update_mission": (Caller(patch("/missions/{mission}", lambda _: {"notes": ""}), About.mission),),
    "move_mission": (
        Caller(
            patch("/missions/{mission}", lambda by: {"project_id": by.objects.target}),
            About.mission,
            undo=sets("UPDATE mission SET project_id = %s WHERE id = %s", "project", "mission"),
        ),
    ),
    "delete_mission": (Caller(delete("/missions/{mission}", dry_run="true"), About.mission),),
    "list_recordings": (Caller(get("/missions/{mission}/recordings"), About.mission),),
    "get_project_stats": (Caller(get("/projects/{project}/stats"), About.project),),
    "get_overview": (
        Caller(
            get("/overview", project_id="{project}"),
            About.mission,
            shows=lambda result, _: result["total"]["files"] > 0,
        ),
    ),
    "list_mission_topics": (Caller(get("/missions/{mission}/topics"), About.mission),),
    "get_mission_timeline": (Caller(get("/missions/{mission}/timeline"), About.mission),),
    "get_recording": (Caller(get("/recordings/{recording}"), About.file),),
    "list_files": (Caller(get("/files", project_id="{project}"), About.file, shows=lists("file")),),
    "get_file": (Caller(get("/files/{file}"), About.file),),
    "download_files": (Caller(post("/files/download", lambda by: {"file_ids": [by.objects.file]}), About.file),),
    "list_file_topics": (Caller(get("/files/{file}/topics"), About.file),),
    "verify_file": (Caller(post("/files/{file}/verify"), About.file),),
    "update_file": (Caller(patch("/files/{file}", lambda _: {"labels": []}), About.file),),
    "move_file": (
        Caller(
            patch("/files/{file}", lambda by: {"mission_id": by.objects.target_mission}),
            About.file,
            undo=sets("UPDATE file SET mission_id = %s WHERE id = %s", "mission", "file"),
        ),
    ),
    "delete_file": (Caller(delete("/files/{file}", dry_run="true"), About.file),),
    "label_files": (
        Caller(
            post("/files/labels", lambda by: {"file_ids": [by.objects.file], "add": [new_name()]}),
            About.file,
            undo=sets("UPDATE file SET labels = '{}' WHERE id = %s", "file"),
            outcome=lambda answer: (answer["items"][0]["problem"] or {"status": 200})["status"],
        ),
    ),
    "search": (
        Caller(
            get("/search", query="project:{project} path:one.mcap"),
            About.file,
            shows=lambda result, by: by.objects.file in {item["id"] for item in result["files"]["items"]},
        ),
    ),
    "get_facets": (
        Caller(
            get("/search/facets", query="project:{project} path:one.mcap"),
            About.file,
            shows=lambda result, _: result["file_count"] > 0,
        ),
    ),
    "list_topics": (
        Caller(
            get("/topics", project_id="{project}"),
            About.file,
            shows=lambda page, by: by.objects.file in {item["file_id"] for item in page["items"]},
        ),
    ),
    "get_stats": (
        Caller(
            get("/stats", project_id="{project}", path="one.mcap"),
            About.file,
            shows=lambda stats, _: stats["total"]["files"] > 0,
        ),
    ),
    "begin_uploads": (
        Caller(
            post("/missions/{mission}/uploads", lambda _: {"files": [{"path": new_name(), "size_bytes": 8}]}),
            About.mission,
        ),
    ),
    "list_uploads": (Caller(get("/missions/{mission}/uploads"), About.mission),),
    "get_upload": (Caller(get("/uploads/{upload}"), About.mission, hides=True),),
    "sign_parts": (Caller(post("/uploads/parts", _part), About.mission, hides=True, undo=_unsign),),
    "complete_uploads": (
        Caller(
            post("/uploads/complete", _finish),
            About.mission,
            hides=True,
            outcome=_outcome,
        ),
    ),
    "abort_upload": (
        Caller(
            delete("/uploads/{upload}"),
            About.mission,
            hides=True,
            undo=lambda by: by.api.sql("UPDATE upload SET state = 'open' WHERE id = %s", by.upload),
        ),
    ),
    "list_trash": (Caller(get("/trash"), About.mission, shows=lists("trashed_mission")),),
    "restore_from_trash": (
        Caller(
            post("/trash/mission/{trashed_mission}/restore"),
            About.mission,
            hides=True,
            undo=_trash_again("mission", "trashed_mission"),
        ),
        Caller(
            post("/trash/file/{trashed_file}/restore"),
            About.mission,
            hides=True,
            undo=_trash_again("file", "trashed_file"),
        ),
        Caller(
            post("/trash/project/{trashed_project}/restore"),
            About.project,
            hides=True,
            undo=_trash_again("project", "trashed_project"),
        ),
    ),
    "get_admin_storage": (Caller(get("/admin/storage"), About.server),),
    "get_admin_jobs": (Caller(get("/admin/jobs"), About.server),),
    "get_admin_scrub": (Caller(get("/admin/scrub"), About.server),),
    "get_admin_health": (Caller(get("/admin/health"), About.server),),
    "get_admin_settings": (Caller(get("/admin/settings"), About.server),),
    "begin_scrub": (Caller(post("/admin/scrub", lambda _: {}), About.server),),
    "retry_jobs": (Caller(post("/admin/jobs/retry"), About.server),),
    "retry_job": (Caller(post("/admin/jobs/1000000000/retry"), About.server, passes="not_found"),),
    "get_home": (Caller(get("/home"), About.server),),
    "get_home_storage": (Caller(get("/home/storage"), About.server),),
    "watch_events": (Caller(get("/events", for_s="0"), About.server),),
    "list_audit_events": (Caller(get("/audit", project_id="{project}"), About.project, shows=has_items),),
    "export_audit_events": (
        Caller(get("/audit/export", project_id="{project}"), About.project, shows=lambda lines, _: bool(lines)),
    ),
}
