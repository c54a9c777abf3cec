"""How the matrix calls each operation on actions, runs and runners."""

import uuid
from typing import Any

from tests.integration.access.call import Caller, delete, get, has_items, lists, new_name, patch, post
from tests.integration.access.expectations import Target
from tests.integration.access.world import ACTION, Principal

_DELETE = 4
_END = {"attempt": 1, "reason": "done", "message": ""}
_UNKNOWN_RUNNER = "00000000-0000-0000-0000-000000000001"
_CAPACITY = {"cores": 64, "memory_bytes": 2**40, "disk_bytes": 2**40, "gpus": 0}
_FREE = {"cores": 1, "memory_bytes": 1, "disk_bytes": 1, "gpus": 0}
_SUMS = {"sha256": "0" * 64, "crc64nvme": "0" * 16, "md5": "0" * 32}


def _hello(principal: Principal) -> Any:
    # A runner with containers: with several accounts, the server refuses runs without containers.
    networks = ["none", "api", "open"]
    abilities = {"executor": "docker", "isolation": "container", "images": True, "networks": networks, "gpus": False}
    return {
        "id": str(uuid.uuid5(uuid.NAMESPACE_OID, str(principal))),  # a token is for one runner
        "name": "runner",
        "capacity": _CAPACITY,
        "default_image": "sha256:stock",
        "abilities": abilities | {"bounds_memory": False, "bounds_disk": False},
        "version": "0",
    }


def _launch(principal: Principal) -> Any:
    return {"mission_ids": [principal.objects.mission], "definition": ACTION, "force": True}


def _launched(answer: Any) -> int:
    item = answer["items"][0]
    return 200 if item["outcome"] == "created" else int(item["problem"]["status"])


def _segment(**more: Any) -> Any:
    return {"attempt": 1, "offset": 0, "size_bytes": 1, **more}


RUN_OPERATIONS: dict[str, tuple[Caller, ...]] = {
    "list_actions": (Caller(get("/actions", project_id="{project}"), Target.project, shows=lists("action")),),
    "create_action": (
        Caller(
            post(
                "/actions",
                lambda principal: {
                    "project_id": principal.objects.project,
                    "definition": ACTION | {"name": new_name()},
                },
            ),
            Target.project,
        ),
    ),
    "get_action": (Caller(get("/actions/{action}"), Target.project),),
    "update_action": (Caller(patch("/actions/{action}", lambda _: {"archived": False}), Target.project),),
    "list_action_versions": (Caller(get("/actions/{action}/versions"), Target.project),),
    "get_action_version": (Caller(get("/actions/{action}/versions/1"), Target.project),),
    "publish_action_version": (
        Caller(post("/actions/{action}/versions", lambda _: {"definition": ACTION}), Target.project),
    ),
    "list_library": (Caller(get("/library", project_id="{project}"), Target.project),),
    "add_from_library": (
        Caller(
            post("/library/slam-evaluate", lambda principal: {"project_id": principal.objects.project}), Target.project
        ),
    ),
    "list_project_actions": (Caller(get("/projects/{project}/actions"), Target.project),),
    "add_project_action": (
        Caller(
            post(
                "/projects/{project}/actions",
                lambda principal: {"action_id": principal.objects.action, "on": "complete"},
            ),
            Target.project,
        ),
    ),
    "remove_project_action": (Caller(delete("/projects/{project}/actions/{action}"), Target.project),),
    "create_runs": (Caller(post("/runs", _launch), Target.mission, outcome=_launched),),
    "record_run": (
        Caller(
            post(
                "/runs/recorded",
                lambda principal: {
                    "mission_id": principal.objects.mission,
                    "name": "pipeline",
                    "script": "true",
                    "inputs": ["one.mcap"],
                },
            ),
            Target.mission,
        ),
    ),
    "list_runs": (Caller(get("/runs", mission_id="{mission}", limit="500"), Target.mission, shows=lists("run")),),
    "get_run": (Caller(get("/runs/{run}"), Target.mission),),
    # The run was started by another person.
    "cancel_run": (Caller(post("/runs/{run}/cancel"), Target.mission, required_level=_DELETE),),
    "retry_run": (Caller(post("/runs/{run}/retry"), Target.mission),),
    "list_run_inputs": (Caller(get("/runs/{run}/inputs"), Target.mission),),
    "list_artifacts": (Caller(get("/runs/{run}/artifacts"), Target.mission),),
    "download_artifacts": (
        Caller(
            post("/runs/{run}/artifacts/download", lambda principal: {"artifact_ids": [principal.objects.artifact]}),
            Target.mission,
        ),
    ),
    "list_mission_previews": (Caller(get("/missions/{mission}/previews"), Target.mission),),
    "get_mission_pictures": (
        Caller(
            post("/missions/pictures", lambda principal: {"mission_ids": [principal.objects.mission]}),
            Target.mission,
            shows=has_items,
        ),
    ),
    "get_run_log": (Caller(get("/runs/{run}/log"), Target.mission),),
    "list_run_checks": (Caller(get("/run-checks", mission_id="{mission}"), Target.mission, shows=has_items),),
    "list_findings": (Caller(get("/findings", mission_id="{mission}"), Target.mission, shows=has_items),),
    "list_run_metrics": (Caller(get("/run-metrics", mission_id="{mission}"), Target.mission, shows=has_items),),
    "list_metrics": (Caller(get("/metrics", mission_id="{mission}"), Target.mission, shows=has_items),),
    "get_metric_table": (
        Caller(
            get("/metrics/table", metric="count", mission_id="{mission}"),
            Target.mission,
            shows=lambda table, _: bool(table["rows"]),
        ),
    ),
    "get_lineage": (Caller(get("/files/{file}/lineage"), Target.file),),
    "list_runners": (Caller(get("/runners"), Target.server),),
    "register_runner": (Caller(post("/runners", _hello), Target.server),),
    "claim_run": (
        Caller(
            post(f"/runners/{_UNKNOWN_RUNNER}/claims", lambda _: {"free": _FREE}),
            Target.server,
            accepted_code="not_found",
        ),
    ),
    "send_heartbeats": (
        Caller(
            post(f"/runners/{_UNKNOWN_RUNNER}/heartbeats", lambda _: {"runs": []}),
            Target.server,
            accepted_code="not_found",
        ),
    ),
    "get_run_context": (
        Caller(get("/runner/runs/{run}/context", attempt="1"), Target.server, accepted_code="run_gone"),
    ),
    "get_run_contexts": (
        Caller(
            post(
                f"/runners/{_UNKNOWN_RUNNER}/contexts",
                lambda principal: {"runs": [{"run_id": principal.objects.run, "attempt": 1}]},
            ),
            Target.server,
            accepted_code="not_found",
        ),
    ),
    "sign_inputs": (
        Caller(
            post("/runner/runs/{run}/inputs", lambda _: {"attempt": 1, "paths": ["one.mcap"]}),
            Target.server,
            accepted_code="run_gone",
        ),
    ),
    "create_log_chunk": (
        Caller(
            post("/runner/runs/{run}/log-chunks", lambda _: _segment(**_SUMS)), Target.server, accepted_code="run_gone"
        ),
    ),
    "confirm_log_chunk": (
        Caller(
            post("/runner/runs/{run}/log-chunks/confirm", lambda _: _segment()), Target.server, accepted_code="run_gone"
        ),
    ),
    "create_artifact_uploads": (
        Caller(
            post("/runner/runs/{run}/uploads", lambda _: {"attempt": 1, "files": [{"path": "a", "size_bytes": 1}]}),
            Target.server,
            accepted_code="run_gone",
        ),
    ),
    "finish_run": (
        Caller(
            post("/runner/runs/{run}/finish", lambda _: _END),
            Target.server,
            accepted_code="run_gone",
        ),
    ),
    "finish_runs": (
        Caller(
            post(
                f"/runners/{_UNKNOWN_RUNNER}/ends",
                lambda principal: {"ends": [{"run_id": principal.objects.run, "finish": _END}]},
            ),
            Target.server,
            accepted_code="not_found",
        ),
    ),
}
