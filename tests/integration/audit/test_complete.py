"""Every operation that changes something declares its audit entry, and writes it."""

import uuid

import pytest

from kleinkram.server.access.operations import OPERATIONS
from tests.integration.access import world as worlds
from tests.integration.access.callers import CALLERS
from tests.integration.access.world import Principal, World
from tests.integration.conftest import StartApi

# The audit entries of each operation. Those in brackets are not written by the calls of the matrix, but by other tests.
WRITES: dict[str, set[str]] = {
    "create_project": {"project.create"},
    "update_project": {"[project.update]"},
    "publish_project": {"project.update"},
    "set_project_isolation": {"project.set_isolation"},
    "set_project_quota": {"project.set_quota"},
    "delete_project": {"[project.delete]"},
    "create_mission": {"mission.create"},
    "update_mission": {"[mission.update]"},
    "move_mission": {"mission.move_out", "mission.move_in"},
    "delete_mission": {"[mission.delete]"},
    "create_mission_event": {"mission.create_event"},
    "update_mission_event": {"[mission.update_event]"},
    "delete_mission_event": {"mission.delete_event"},
    "create_viewer_layout": {"project.create_layout"},
    "share_viewer_layout": {"project.create_layout"},
    "update_viewer_layout": {"[project.update_layout]"},
    "delete_viewer_layout": {"project.delete_layout"},
    "set_project_checks": {"[project.set_checks]"},
    "create_check_report": {"mission.report_checks"},
    "accept_check": {"[mission.accept_check]"},
    "withdraw_acceptance": {"mission.withdraw_acceptance"},
    "create_check_note": {"mission.create_check_note"},
    "delete_check_note": {"mission.delete_check_note"},
    "download_files": {"file.download", "[file.preview]"},
    "verify_file": {"file.verify"},
    "get_file_thumbnails": {"[mission.preview]"},
    "make_recording_preview": {"[file.make_preview]"},
    "delete_recording_preview": {"file.delete_preview"},
    "update_file": {"[file.update]"},
    "label_files": {"file.update"},
    "move_file": {"file.move_out", "file.move_in"},
    "delete_file": {"[file.delete]"},
    "complete_uploads": {"[file.upload]", "[file.repair]"},
    "abort_upload": {"upload.abort"},
    "restore_from_trash": {"project.restore", "mission.restore", "file.restore"},
    "create_action": {"action.create"},
    "update_action": {"[action.archive]", "[action.restore]"},
    "publish_action_version": {"[action.publish]"},
    "add_from_library": {"action.create", "[action.publish]"},
    "add_project_action": {"project.add_action"},
    "remove_project_action": {"[project.remove_action]"},
    "create_runs": {"run.create"},
    "record_run": {"[run.record]"},
    "retry_run": {"run.create"},
    "cancel_run": {"[run.cancel]"},
    "download_artifacts": {"run.download", "[run.preview]"},
    "get_mission_pictures": {"project.preview"},
    "register_runner": {"[runner.register]"},
    "finish_run": {"[run.end]", "[file.create]"},
    "finish_runs": {"[run.end]", "[file.create]"},
    # Messages of a runner during a run. The audit entry is written when the run ends.
    "claim_run": set(),
    "send_heartbeats": set(),
    "get_run_contexts": set(),
    "sign_inputs": set(),
    "create_log_chunk": set(),
    "confirm_log_chunk": set(),
    "create_artifact_uploads": set(),
    "create_project_grant": {"grant.create"},
    "create_mission_grant": {"grant.create"},
    "update_project_grant": {"[grant.change]"},
    "update_mission_grant": {"[grant.change]"},
    "delete_project_grant": {"grant.revoke"},
    "delete_mission_grant": {"grant.revoke"},
    "create_group": {"group.create"},
    "update_group": {"group.rename"},
    "delete_group": {"group.delete"},
    "set_group_member": {"group.member"},
    "remove_group_member": {"group.member"},
    "make_admin": {"person.make_admin"},
    "unmake_admin": {"[person.unmake_admin]"},
    "deactivate_person": {"person.deactivate", "token.revoke"},
    "reactivate_person": {"[person.reactivate]"},
    "erase_person": {"[person.erase]"},
    "export_person": {"person.export"},
    "invite_person": {"invitation.create"},
    "create_reset_link": {"password.reset_link"},
    "retry_job": {"[job.retry]"},
    "retry_jobs": {"[job.retry]"},
    "begin_scrub": {"store.scrub"},
    "create_token": {"token.create"},
    "revoke_token": {"token.revoke"},
    "create_share": {"share.create"},
    "revoke_share": {"share.revoke"},
    "end_session": {"session.revoke"},
    "unlink_identity": {"identity.unlink"},
    "end_all_sessions": {"[session.revoke]"},
    "change_password": {"[password.change]"},
    "link_provider": {"[identity.link]"},
    "create_owner_link": {"[link.create]"},
    "approve_cli_login": {"[login.approve]"},
    "approve_device_login": {"[login.approve]"},
    "deny_device_login": {"[login.deny]"},
    "sign_in_by_password": {"[session.create]"},
    "sign_in_by_link": {"[session.create]"},
    "accept_invitation": {"[person.create]", "[session.create]"},
    "reset_password": {"[password.reset]", "[session.create]"},
    "bootstrap_admin": {"[server.bootstrap]", "[session.create]"},
    "end_provider_sign_in": {"[session.create]", "[person.create]"},
    "end_provider_sessions": {"[session.revoke]"},
    "exchange_cli_code": {"[token.create]"},
    "exchange_device_code": {"[token.create]"},
    "sign_out": {"[session.revoke]"},
    # Reservations of names and signed URLs. The audit entry is written when the upload is completed.
    "begin_uploads": {"[file.link]"},
    "sign_parts": set(),
    # States that expire within minutes and permit nothing.
    "begin_device_login": set(),
    "begin_provider_sign_in": set(),
    "get_code": set(),
    "get_device_login": set(),
    "begin_provider_reauthentication": set(),
    "begin_totp": set(),
    "confirm_totp": {"[totp.enable]"},
    "disable_totp": {"[totp.disable]"},
    "reauthenticate_by_password": {"[session.renew]"},
    "renew_recovery_codes": {"[totp.renew_codes]"},
    "reset_totp": {"[totp.reset]"},
}


@pytest.fixture(scope="module")
def world(start_api: StartApi) -> World:
    return worlds.build(start_api(), levels_per_credential=1)


@pytest.fixture(scope="module")
def admin(world: World) -> Principal:
    """An admin, whom no operation refuses."""
    return next(principal for principal in world.principals if principal.named.startswith("admin with"))


def test_every_operation_that_changes_something_is_listed(world: World) -> None:
    paths = world.api.app.openapi()["paths"]
    changing = {
        operation["operationId"]
        for path in paths.values()
        for method, operation in path.items()
        if method in {"post", "put", "patch", "delete"}
    }
    # These operations share the route of another operation.
    of_projects = {"publish_project", "set_project_isolation", "set_project_quota"}
    shared_route = {"move_mission", "move_file", "share_viewer_layout", *of_projects}
    # These are read requests, or requests of providers, which are no part of the API.
    others = {"end_provider_sign_in", "end_provider_sessions", "export_person"}
    assert changing | shared_route | others == WRITES.keys()
    assert WRITES.keys() <= OPERATIONS.keys()


@pytest.mark.parametrize("operation", [name for name, written in WRITES.items() if any("[" not in w for w in written)])
def test_an_operation_writes_its_audit_events(world: World, admin: Principal, operation: str) -> None:
    written = set()
    for caller in CALLERS[operation]:
        requested, request_id = caller.request(admin), uuid.uuid4().hex
        headers = {**admin.headers, "X-Request-Id": request_id}
        answer = world.api.as_(None).call(requested.method, requested.path, requested.body, requested.query, headers)
        assert answer.status < 300, answer
        rows = world.api.sql(
            "SELECT operation, actor_id, token_id, session_id, address FROM audit_event WHERE request_id = %s",
            request_id,
        )
        if caller.undo is not None:
            caller.undo(admin)
        written |= {row[0] for row in rows}
        for _, actor_id, token_id, session_id, address in rows:
            assert actor_id is not None
            assert token_id is not None or session_id is not None
            assert address == "127.0.0.1"
    assert written == {item for item in WRITES[operation] if "[" not in item}
