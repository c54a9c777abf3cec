"""How the matrix calls each operation on projects, missions, files, uploads, the trash and the audit log."""

import random
from collections.abc import Callable
from typing import Any

from tests.integration.access.call import Caller, delete, get, has_items, lists, new_name, patch, post, put, sets
from tests.integration.access.expectations import Target
from tests.integration.access.world import Principal, trash


def _outcome(answer: Any) -> int:
    """Return the status of an upload. 409 means that the caller may complete it, but no part was uploaded."""
    status: int = answer["items"][0]["problem"]["status"]
    return 200 if status == 409 else status


def _part(principal: Principal) -> Any:
    return {"parts": [{"upload_id": principal.upload, "number": 1, "checksum": "0" * 16}]}


def _reset_signed_checksum(principal: Principal) -> None:
    principal.api.sql("UPDATE upload SET signed_checksum = NULL WHERE id = %s", principal.upload)


def _completion(principal: Principal) -> Any:
    return {"uploads": [{"upload_id": principal.upload, "sha256": "0" * 64, "crc64nvme": "0" * 16}]}


def _move_back_to_trash(table: str, attribute: str) -> Callable[[Principal], None]:
    return lambda principal: trash(principal.api, table, getattr(principal.objects, attribute))


def _other_isolation(principal: Principal) -> Any:
    """Return another isolation than the project has: nothing is checked where nothing changes."""
    ((now,),) = principal.api.sql("SELECT isolation FROM project WHERE id = %s", principal.objects.project)
    return {"isolation": "container" if now == "namespaces" else "namespaces"}


def _layout(*, is_shared: bool) -> Any:
    return {"name": new_name(), "panels": ["raw:1@/imu"], "is_shared": is_shared}


def _delete_new_layouts(principal: Principal) -> None:
    """Delete the layouts that principals created: the number of shared ones is limited."""
    principal.api.sql("DELETE FROM viewer_layout WHERE is_shared AND starts_with(name, 'new ')")


_CHECK_REPORT = {
    "checks": [{"name": "topic.gap", "status": "ok", "message": "No gap."}],
    "depth": "index",
    "document_sha256": "0" * 64,
    "profiles_applied": [],
    "files": {"one.mcap": "0" * 64},
}


OBJECT_OPERATIONS: dict[str, tuple[Caller, ...]] = {
    "list_projects": (Caller(get("/projects", name="{project_name}"), Target.project, shows=lists("project")),),
    "create_project": (
        Caller(post("/projects", lambda _: {"name": new_name()}), Target.server, needs_unlimited_credential=True),
    ),
    "get_project": (Caller(get("/projects/{project}"), Target.project),),
    "update_project": (Caller(patch("/projects/{project}", lambda _: {"description": ""}), Target.project),),
    "publish_project": (
        Caller(patch("/projects/{project}", lambda _: {"citation": new_name()}), Target.project, via="update_project"),
    ),
    "set_project_isolation": (
        Caller(
            patch("/projects/{project}", _other_isolation),
            Target.project,
            via="update_project",
        ),
    ),
    "set_project_quota": (
        Caller(
            patch("/projects/{project}", lambda _: {"quota_files": random.randrange(10**6, 10**9)}),
            Target.project,
            via="update_project",
        ),
    ),
    "delete_project": (Caller(delete("/projects/{project}", dry_run="true"), Target.project),),
    "get_mission_template": (Caller(get("/projects/{project}/template"), Target.project),),
    "create_mission": (Caller(post("/projects/{project}/missions", lambda _: {"name": new_name()}), Target.project),),
    "list_missions": (Caller(get("/missions", name="{mission_name}"), Target.mission, shows=lists("mission")),),
    "list_mission_positions": (
        Caller(
            get("/mission-positions", name="{mission_name}"),
            Target.mission,
            shows=lambda result, _: result["unplaced_count"] > 0,
        ),
    ),
    "get_mission": (Caller(get("/missions/{mission}"), Target.mission),),
    "update_mission": (Caller(patch("/missions/{mission}", lambda _: {"notes": ""}), Target.mission),),
    "move_mission": (
        Caller(
            patch("/missions/{mission}", lambda principal: {"project_id": principal.objects.destination}),
            Target.mission,
            undo=sets("UPDATE mission SET project_id = %s WHERE id = %s", "project", "mission"),
        ),
    ),
    "delete_mission": (Caller(delete("/missions/{mission}", dry_run="true"), Target.mission),),
    "list_recordings": (Caller(get("/missions/{mission}/recordings"), Target.mission),),
    "get_project_stats": (Caller(get("/projects/{project}/stats"), Target.project),),
    "get_overview": (
        Caller(
            get("/overview", project_id="{project}"),
            Target.mission,
            shows=lambda result, _: result["total"]["files"] > 0,
        ),
    ),
    "list_mission_topics": (Caller(get("/missions/{mission}/topics"), Target.mission),),
    "get_mission_timeline": (Caller(get("/missions/{mission}/timeline"), Target.mission),),
    "get_recording": (Caller(get("/recordings/{recording}"), Target.file),),
    "get_project_checks": (Caller(get("/projects/{project}/checks"), Target.project),),
    "set_project_checks": (Caller(put("/projects/{project}/checks", lambda _: {"text": ""}), Target.project),),
    "list_checks_versions": (Caller(get("/projects/{project}/checks/versions"), Target.project),),
    "get_checks_version": (Caller(get("/projects/{project}/checks/versions/1"), Target.project),),
    "get_check_matrix": (Caller(get("/projects/{project}/checks/matrix"), Target.project),),
    "get_check_trend": (Caller(get("/projects/{project}/checks/trend"), Target.project),),
    "get_mission_checks": (Caller(get("/missions/{mission}/checks"), Target.mission),),
    "create_check_report": (
        Caller(post("/missions/{mission}/check-reports", lambda _: _CHECK_REPORT), Target.mission),
    ),
    "accept_check": (
        # No check of the mission fails.
        Caller(
            post("/missions/{mission}/check-acceptances", lambda _: {"check": "topic.rate", "because": "A reason."}),
            Target.mission,
            accepted_code="invalid_request",
        ),
    ),
    "withdraw_acceptance": (
        Caller(
            delete("/missions/{mission}/check-acceptances/{acceptance}"),
            Target.mission,
            undo=sets(
                "UPDATE check_acceptance SET ended = NULL, ended_at = NULL, ended_by_id = NULL WHERE id = %s",
                "acceptance",
            ),
        ),
    ),
    "create_mission_event": (
        Caller(post("/missions/{mission}/events", lambda _: {"name": new_name(), "start_ns": 1}), Target.mission),
    ),
    "list_mission_events": (
        Caller(get("/mission-events", mission_id="{mission}"), Target.event, shows=lists("event")),
    ),
    "get_mission_event": (Caller(get("/mission-events/{event}"), Target.event),),
    "update_mission_event": (Caller(patch("/mission-events/{event}", lambda _: {"note": ""}), Target.event),),
    "delete_mission_event": (
        Caller(
            delete("/mission-events/{event}"),
            Target.event,
            undo=sets(
                "INSERT INTO mission_event (id, mission_id, name, name_key, start_ns, created_by_id)"
                " SELECT %s, id, 'stumble', 'stumble', 1, created_by_id FROM mission WHERE id = %s",
                *("event", "mission"),
            ),
        ),
    ),
    "list_viewer_layouts": (Caller(get("/projects/{project}/viewer-layouts"), Target.project),),
    "create_viewer_layout": (
        Caller(post("/projects/{project}/viewer-layouts", lambda _: _layout(is_shared=False)), Target.project),
    ),
    "share_viewer_layout": (
        Caller(
            post("/projects/{project}/viewer-layouts", lambda _: _layout(is_shared=True)),
            Target.project,
            via="create_viewer_layout",
            undo=_delete_new_layouts,
        ),
    ),
    "update_viewer_layout": (
        Caller(patch("/projects/{project}/viewer-layouts/{layout}", lambda _: {"is_default": False}), Target.project),
    ),
    "delete_viewer_layout": (
        Caller(
            delete("/projects/{project}/viewer-layouts/{layout}"),
            Target.project,
            undo=sets(
                "INSERT INTO viewer_layout (id, project_id, name, name_key, panels, is_shared, created_by_id)"
                " SELECT %s, id, 'cameras', 'cameras', '{raw:1@/imu}', true, created_by_id FROM project WHERE id = %s",
                *("layout", "project"),
            ),
        ),
    ),
    "create_check_note": (
        Caller(
            post("/missions/{mission}/check-notes", lambda _: {"check": "topic.gap", "text": new_name()}),
            Target.mission,
        ),
    ),
    "delete_check_note": (
        Caller(
            delete("/missions/{mission}/check-notes/{note}"),
            Target.mission,
            undo=sets(
                "INSERT INTO check_note (id, mission_id, check_name, text, created_by_id)"
                " SELECT %s, id, 'topic.gap', 'x', created_by_id FROM mission WHERE id = %s",
                *("note", "mission"),
            ),
        ),
    ),
    "list_files": (Caller(get("/files", project_id="{project}"), Target.file, shows=lists("file")),),
    "get_file": (Caller(get("/files/{file}"), Target.file),),
    "download_files": (
        Caller(post("/files/download", lambda principal: {"file_ids": [principal.objects.file]}), Target.file),
    ),
    "slice_file": (
        # Refused for its time, after the rights: a slice starts a process.
        Caller(get("/files/{file}/slice.mcap", start="never"), Target.file, accepted_code="invalid_request"),
    ),
    "list_file_topics": (Caller(get("/files/{file}/topics"), Target.file),),
    "get_recording_preview": (Caller(get("/files/{file}/preview"), Target.file),),
    "make_recording_preview": (
        # Refused for the content of the file, after the rights.
        Caller(post("/files/{file}/preview"), Target.file, accepted_code="invalid_request"),
    ),
    "delete_recording_preview": (
        Caller(
            delete("/files/{file}/preview"),
            Target.file,
            undo=sets(
                "UPDATE recording_preview SET thumbnail = 'JPEG' "
                "WHERE blob_id = (SELECT blob_id FROM file WHERE id = %s)",
                "file",
            ),
        ),
    ),
    "get_file_thumbnails": (
        Caller(
            post("/files/thumbnails", lambda principal: {"file_ids": [principal.objects.file]}),
            Target.file,
            shows=has_items,
        ),
    ),
    "verify_file": (Caller(post("/files/{file}/verify"), Target.file),),
    "update_file": (Caller(patch("/files/{file}", lambda _: {"labels": []}), Target.file),),
    "move_file": (
        Caller(
            patch("/files/{file}", lambda principal: {"mission_id": principal.objects.destination_mission}),
            Target.file,
            undo=sets("UPDATE file SET mission_id = %s WHERE id = %s", "mission", "file"),
        ),
    ),
    "delete_file": (Caller(delete("/files/{file}", dry_run="true"), Target.file),),
    "label_files": (
        Caller(
            post("/files/labels", lambda principal: {"file_ids": [principal.objects.file], "add": [new_name()]}),
            Target.file,
            undo=sets("UPDATE file SET labels = '{}' WHERE id = %s", "file"),
            outcome=lambda answer: (answer["items"][0]["problem"] or {"status": 200})["status"],
        ),
    ),
    "search": (
        Caller(
            get("/search", query="project:{project} path:one.mcap"),
            Target.file,
            shows=lambda result, principal: principal.objects.file in {item["id"] for item in result["files"]["items"]},
        ),
    ),
    "get_facets": (
        Caller(
            get("/search/facets", query="project:{project} path:one.mcap"),
            Target.file,
            shows=lambda result, _: result["file_count"] > 0,
        ),
    ),
    "list_topics": (
        Caller(
            get("/topics", project_id="{project}"),
            Target.file,
            shows=lambda page, principal: principal.objects.file in {item["file_id"] for item in page["items"]},
        ),
    ),
    "get_stats": (
        Caller(
            get("/stats", project_id="{project}", path="one.mcap"),
            Target.file,
            shows=lambda stats, _: stats["total"]["files"] > 0,
        ),
    ),
    "begin_uploads": (
        Caller(
            post("/missions/{mission}/uploads", lambda _: {"files": [{"path": new_name(), "size_bytes": 8}]}),
            Target.mission,
        ),
    ),
    "list_uploads": (Caller(get("/missions/{mission}/uploads"), Target.mission),),
    "get_upload": (Caller(get("/uploads/{upload}"), Target.mission, hides=True),),
    "sign_parts": (Caller(post("/uploads/parts", _part), Target.mission, hides=True, undo=_reset_signed_checksum),),
    "complete_uploads": (
        Caller(
            post("/uploads/complete", _completion),
            Target.mission,
            hides=True,
            outcome=_outcome,
        ),
    ),
    "abort_upload": (
        Caller(
            delete("/uploads/{upload}"),
            Target.mission,
            hides=True,
            undo=lambda principal: principal.api.sql(
                "UPDATE upload SET state = 'open' WHERE id = %s", principal.upload
            ),
        ),
    ),
    "list_trash": (Caller(get("/trash"), Target.mission, shows=lists("trashed_mission")),),
    "restore_from_trash": (
        Caller(
            post("/trash/mission/{trashed_mission}/restore"),
            Target.mission,
            hides=True,
            undo=_move_back_to_trash("mission", "trashed_mission"),
        ),
        Caller(
            post("/trash/file/{trashed_file}/restore"),
            Target.mission,
            hides=True,
            undo=_move_back_to_trash("file", "trashed_file"),
        ),
        Caller(
            post("/trash/project/{trashed_project}/restore"),
            Target.project,
            hides=True,
            undo=_move_back_to_trash("project", "trashed_project"),
        ),
    ),
    "get_admin_storage": (Caller(get("/admin/storage"), Target.server),),
    "get_admin_jobs": (Caller(get("/admin/jobs"), Target.server),),
    "get_admin_scrub": (Caller(get("/admin/scrub"), Target.server),),
    "get_admin_health": (Caller(get("/admin/health"), Target.server),),
    "get_admin_status": (Caller(get("/admin/status"), Target.server),),
    "get_admin_settings": (Caller(get("/admin/settings"), Target.server),),
    "begin_scrub": (Caller(post("/admin/scrub", lambda _: {}), Target.server),),
    "retry_jobs": (Caller(post("/admin/jobs/retry"), Target.server),),
    "retry_job": (Caller(post("/admin/jobs/1000000000/retry"), Target.server, accepted_code="not_found"),),
    "get_home": (Caller(get("/home"), Target.server),),
    "get_home_storage": (Caller(get("/home/storage"), Target.server),),
    "watch_events": (Caller(get("/events", for_s="0"), Target.server),),
    "list_audit_events": (Caller(get("/audit", project_id="{project}"), Target.project, shows=has_items),),
    "export_audit_events": (
        Caller(get("/audit/export", project_id="{project}"), Target.project, shows=lambda lines, _: bool(lines)),
    ),
}
