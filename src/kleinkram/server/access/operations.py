"""The permissions that each operation of the API requires. Tests are derived from this table.

A route without a row prevents the start of the server. A token needs one of `scopes`; browsers have all.
"""

import enum
from dataclasses import dataclass

from kleinkram.contract.access import Right, Scope


class ResourceKind(str, enum.Enum):
    """The kind of object on which an operation requires its right."""

    visible = "visible"  # all objects that are visible to the actor
    server = "server"  # for admins
    project = "project"
    mission = "mission"
    none = "none"  # the actor's own objects, or nobody's


@dataclass(frozen=True)
class Permission:
    """Requirements of an operation. `guests`: also without an account, on public and shared objects.

    `runners`: also by runners for their runs, with any scopes; `only_runners`: by nobody else.
    `also`: tokens also need this scope. `browsers`: only with a browser session, no token.
    `fresh`: only shortly after signing in. `unrestricted`: only with a credential without limits.
    """

    on: ResourceKind
    right: Right | None
    scopes: frozenset[Scope]
    guests: bool = False
    runners: bool = False
    only_runners: bool = False
    also: Scope | None = None
    browsers: bool = False
    unrestricted: bool = False
    fresh: bool = False


_NAMES = frozenset({Scope.read, Scope.upload})
_READ = frozenset({Scope.read})
_UPLOAD = frozenset({Scope.upload})
_WRITE = frozenset({Scope.write})
_ADMIN = frozenset({Scope.admin})
_RUN = frozenset({Scope.run})
_ANY = frozenset(Scope)


def _visible(scopes: frozenset[Scope] = _READ, *, guests: bool = True) -> Permission:
    return Permission(ResourceKind.visible, Right.read, scopes, guests)


def _public_endpoint() -> Permission:
    return Permission(ResourceKind.none, None, _ANY, guests=True)


def _runner() -> Permission:
    return Permission(ResourceKind.none, None, _RUN, runners=True, only_runners=True)


OPERATIONS: dict[str, Permission] = {
    # Projects
    "list_projects": _visible(_NAMES),
    "create_project": Permission(ResourceKind.none, None, _WRITE),
    "get_project": Permission(ResourceKind.project, Right.read, _NAMES, guests=True),
    "update_project": Permission(ResourceKind.project, Right.write, _WRITE),
    "publish_project": Permission(ResourceKind.project, Right.delete, _ADMIN),
    "set_project_isolation": Permission(ResourceKind.project, Right.delete, _ADMIN),
    "set_project_quota": Permission(ResourceKind.server, None, _ADMIN),
    "delete_project": Permission(ResourceKind.project, Right.delete, _WRITE),
    "get_mission_template": Permission(ResourceKind.project, Right.read, _NAMES),
    # Missions
    "create_mission": Permission(ResourceKind.project, Right.create, _UPLOAD),
    "list_missions": _visible(_NAMES),
    "list_mission_positions": _visible(),
    "get_mission": Permission(ResourceKind.mission, Right.read, _NAMES, guests=True),
    "update_mission": Permission(ResourceKind.mission, Right.write, _WRITE),
    "move_mission": Permission(ResourceKind.mission, Right.delete, _WRITE),
    "delete_mission": Permission(ResourceKind.mission, Right.delete, _WRITE),
    "list_recordings": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "get_recording": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "get_project_stats": Permission(ResourceKind.project, Right.read, _READ, guests=True),
    "get_overview": _visible(),
    "list_mission_topics": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "get_mission_timeline": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    # Events of missions. CREATE on the mission suffices to change and delete one's own.
    "create_mission_event": Permission(ResourceKind.mission, Right.create, _UPLOAD),
    "list_mission_events": _visible(),
    "get_mission_event": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "update_mission_event": Permission(ResourceKind.mission, Right.write, _WRITE),
    "delete_mission_event": Permission(ResourceKind.mission, Right.delete, _WRITE),
    # Layouts of the viewer. READ on the project suffices to have personal ones, and to change and delete these.
    "list_viewer_layouts": Permission(ResourceKind.project, Right.read, _READ, guests=True),
    "create_viewer_layout": Permission(ResourceKind.project, Right.read, _WRITE),
    "share_viewer_layout": Permission(ResourceKind.project, Right.write, _WRITE),
    "update_viewer_layout": Permission(ResourceKind.project, Right.write, _WRITE),
    "delete_viewer_layout": Permission(ResourceKind.project, Right.write, _WRITE),
    # Checks
    "get_project_checks": Permission(ResourceKind.project, Right.read, _NAMES, guests=True),
    "set_project_checks": Permission(ResourceKind.project, Right.write, _WRITE),
    "list_checks_versions": Permission(ResourceKind.project, Right.read, _READ, guests=True),
    "get_checks_version": Permission(ResourceKind.project, Right.read, _READ, guests=True),
    "get_check_matrix": Permission(ResourceKind.project, Right.read, _READ, guests=True),
    "get_check_trend": Permission(ResourceKind.project, Right.read, _READ, guests=True),
    "get_mission_checks": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "create_check_report": Permission(ResourceKind.mission, Right.create, _UPLOAD),
    "accept_check": Permission(ResourceKind.mission, Right.write, _WRITE),
    "withdraw_acceptance": Permission(ResourceKind.mission, Right.write, _WRITE),
    "create_check_note": Permission(ResourceKind.mission, Right.write, _WRITE),
    "delete_check_note": Permission(ResourceKind.mission, Right.write, _WRITE),
    # Files
    "list_files": _visible(),
    "get_file": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "download_files": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "slice_file": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "list_file_topics": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "verify_file": Permission(ResourceKind.mission, Right.read, _READ),
    "get_recording_preview": Permission(ResourceKind.mission, Right.read, _READ, guests=True),
    "get_file_thumbnails": _visible(),
    "make_recording_preview": Permission(ResourceKind.mission, Right.delete, _WRITE),
    "delete_recording_preview": Permission(ResourceKind.mission, Right.delete, _WRITE),
    "update_file": Permission(ResourceKind.mission, Right.write, _WRITE),
    "move_file": Permission(ResourceKind.mission, Right.delete, _WRITE),
    "delete_file": Permission(ResourceKind.mission, Right.delete, _WRITE),
    "label_files": Permission(ResourceKind.mission, Right.write, _WRITE),
    "search": _visible(),
    "get_facets": _visible(),
    "list_topics": _visible(),
    "get_stats": _visible(),
    # Uploads
    "begin_uploads": Permission(ResourceKind.mission, Right.create, _UPLOAD),
    "list_uploads": Permission(ResourceKind.mission, Right.create, _UPLOAD),
    "get_upload": Permission(ResourceKind.mission, Right.create, _UPLOAD),
    "sign_parts": Permission(ResourceKind.mission, Right.create, _UPLOAD, runners=True),
    "complete_uploads": Permission(ResourceKind.mission, Right.create, _UPLOAD, runners=True),
    "abort_upload": Permission(ResourceKind.mission, Right.create, _UPLOAD, runners=True),
    # Actions of a project, or of the whole lab, which everybody with an account sees
    "list_actions": _visible(guests=False),
    "create_action": Permission(ResourceKind.project, Right.write, _WRITE),
    "get_action": Permission(ResourceKind.project, Right.read, _READ),
    "update_action": Permission(ResourceKind.project, Right.write, _WRITE),
    "list_action_versions": Permission(ResourceKind.project, Right.read, _READ),
    "get_action_version": Permission(ResourceKind.project, Right.read, _READ),
    "publish_action_version": Permission(ResourceKind.project, Right.write, _WRITE),
    # The actions that are shipped with the server, of which a project or the whole lab has some
    "list_library": Permission(ResourceKind.project, Right.read, _READ),
    "add_from_library": Permission(ResourceKind.project, Right.write, _WRITE),
    # Actions that a project names
    "list_project_actions": Permission(ResourceKind.project, Right.read, _READ),
    "add_project_action": Permission(ResourceKind.project, Right.write, _WRITE, also=Scope.run),
    "remove_project_action": Permission(ResourceKind.project, Right.write, _WRITE),
    # Runs. Starting one also requires the rights of its action; cancelling another person's requires DELETE.
    "create_runs": Permission(ResourceKind.mission, Right.create, _RUN, also=Scope.read),
    "record_run": Permission(ResourceKind.mission, Right.create, _UPLOAD, also=Scope.read),
    "list_runs": _visible(guests=False),
    "get_run": Permission(ResourceKind.mission, Right.read, _READ),
    "cancel_run": Permission(ResourceKind.mission, Right.create, _RUN, also=Scope.read),
    "retry_run": Permission(ResourceKind.mission, Right.create, _RUN, also=Scope.read),
    "list_run_inputs": Permission(ResourceKind.mission, Right.read, _READ),
    "list_artifacts": Permission(ResourceKind.mission, Right.read, _READ),
    "download_artifacts": Permission(ResourceKind.mission, Right.read, _READ),
    "list_mission_previews": Permission(ResourceKind.mission, Right.read, _READ),
    "get_mission_pictures": _visible(guests=False),
    "get_run_log": Permission(ResourceKind.mission, Right.read, _READ),
    "list_run_checks": _visible(guests=False),
    "list_findings": _visible(guests=False),
    "list_run_metrics": _visible(guests=False),
    "list_metrics": _visible(guests=False),
    "get_metric_table": _visible(guests=False),
    "get_lineage": Permission(ResourceKind.mission, Right.read, _READ),
    # Runners, for their own runs
    "list_runners": Permission(ResourceKind.server, None, _ADMIN),
    "register_runner": _runner(),
    "claim_run": _runner(),
    "send_heartbeats": _runner(),
    "get_run_context": _runner(),
    "get_run_contexts": _runner(),
    "sign_inputs": _runner(),
    "create_log_chunk": _runner(),
    "confirm_log_chunk": _runner(),
    "create_artifact_uploads": _runner(),
    "finish_run": _runner(),
    "finish_runs": _runner(),
    # Rights. Those who may change them see all; others see only their own.
    "list_project_grants": Permission(ResourceKind.project, Right.write, _READ),
    "list_mission_grants": Permission(ResourceKind.mission, Right.write, _READ),
    "create_project_grant": Permission(ResourceKind.project, Right.write, _ADMIN),
    "create_mission_grant": Permission(ResourceKind.mission, Right.write, _ADMIN),
    "update_project_grant": Permission(ResourceKind.project, Right.write, _ADMIN),
    "update_mission_grant": Permission(ResourceKind.mission, Right.write, _ADMIN),
    "delete_project_grant": Permission(ResourceKind.project, Right.write, _ADMIN),
    "delete_mission_grant": Permission(ResourceKind.mission, Right.write, _ADMIN),
    "get_project_access": Permission(ResourceKind.project, Right.read, _READ),
    "get_mission_access": Permission(ResourceKind.mission, Right.read, _READ),
    # Groups: visible to their members, changed by their editors
    "list_groups": Permission(ResourceKind.none, None, _READ),
    "create_group": Permission(ResourceKind.none, None, _ADMIN),
    "get_group": Permission(ResourceKind.none, None, _READ),
    "update_group": Permission(ResourceKind.none, None, _ADMIN),
    "delete_group": Permission(ResourceKind.none, None, _ADMIN),
    "list_group_members": Permission(ResourceKind.none, None, _READ),
    "set_group_member": Permission(ResourceKind.none, None, _ADMIN),
    "remove_group_member": Permission(ResourceKind.none, None, _ADMIN),
    # People: visible to those who share a group or project with them
    "list_people": Permission(ResourceKind.none, None, _READ),
    "get_person": Permission(ResourceKind.none, None, _READ),
    "make_admin": Permission(ResourceKind.server, None, _ADMIN, fresh=True),
    "unmake_admin": Permission(ResourceKind.server, None, _ADMIN),
    "deactivate_person": Permission(ResourceKind.server, None, _ADMIN),
    "reactivate_person": Permission(ResourceKind.server, None, _ADMIN),
    "erase_person": Permission(ResourceKind.server, None, _ADMIN, fresh=True),
    "get_erasure": Permission(ResourceKind.server, None, _ADMIN),
    # One's own data; admins export everybody's.
    "export_person": Permission(ResourceKind.none, None, _ADMIN, unrestricted=True),
    # Trash
    "list_trash": Permission(ResourceKind.visible, Right.delete, _READ),
    "restore_from_trash": Permission(ResourceKind.mission, Right.delete, _WRITE),
    # Tokens. Every token may revoke itself; everything else requires the scope admin, which robots do not have.
    "create_token": Permission(ResourceKind.none, None, _ADMIN),
    "list_tokens": Permission(ResourceKind.none, None, _ADMIN, unrestricted=True),
    "revoke_token": Permission(ResourceKind.none, None, _ANY),
    # Links. Creating one gives others access, which requires the scope admin.
    "create_share": Permission(ResourceKind.mission, Right.write, _ADMIN),
    "list_shares": Permission(ResourceKind.visible, Right.write, _READ),
    "revoke_share": Permission(ResourceKind.mission, Right.write, _WRITE),
    "get_share": _visible(),
    # Signing in: without an account
    "list_sign_in_methods": _public_endpoint(),
    "sign_in_by_password": _public_endpoint(),
    "sign_in_by_link": _public_endpoint(),
    "get_code": _public_endpoint(),
    "accept_invitation": _public_endpoint(),
    "reset_password": _public_endpoint(),
    "bootstrap_admin": _public_endpoint(),
    "begin_provider_sign_in": _public_endpoint(),
    "end_provider_sign_in": _public_endpoint(),
    # By the provider itself, with a token that it has signed.
    "end_provider_sessions": _public_endpoint(),
    "begin_device_login": _public_endpoint(),
    "exchange_device_code": _public_endpoint(),
    "exchange_cli_code": _public_endpoint(),
    "sign_out": _public_endpoint(),
    # The own account
    "get_me": Permission(ResourceKind.none, None, _ANY, runners=True),
    "list_sessions": Permission(ResourceKind.none, None, _ADMIN, unrestricted=True),
    "end_session": Permission(ResourceKind.none, None, _ADMIN, unrestricted=True),
    "end_all_sessions": Permission(ResourceKind.none, None, _ADMIN, unrestricted=True),
    "get_account": Permission(ResourceKind.none, None, _ADMIN, unrestricted=True),
    "list_identities": Permission(ResourceKind.none, None, _ADMIN, unrestricted=True),
    "unlink_identity": Permission(ResourceKind.none, None, _ADMIN, unrestricted=True, fresh=True),
    "create_owner_link": Permission(ResourceKind.server, None, _ADMIN, fresh=True),
    "change_password": Permission(ResourceKind.none, None, _ADMIN, browsers=True, fresh=True),
    "link_provider": Permission(ResourceKind.none, None, _ADMIN, browsers=True, fresh=True),
    "approve_cli_login": Permission(ResourceKind.none, None, _ADMIN, browsers=True, fresh=True),
    "get_device_login": Permission(ResourceKind.none, None, _ADMIN, browsers=True),
    "approve_device_login": Permission(ResourceKind.none, None, _ADMIN, browsers=True, fresh=True),
    "deny_device_login": Permission(ResourceKind.none, None, _ADMIN, browsers=True),
    "reauthenticate_by_password": Permission(ResourceKind.none, None, _ADMIN, browsers=True),
    "begin_provider_reauthentication": Permission(ResourceKind.none, None, _ADMIN, browsers=True),
    "begin_totp": Permission(ResourceKind.none, None, _ADMIN, browsers=True, fresh=True),
    "confirm_totp": Permission(ResourceKind.none, None, _ADMIN, browsers=True, fresh=True),
    "disable_totp": Permission(ResourceKind.none, None, _ADMIN, browsers=True, fresh=True),
    "renew_recovery_codes": Permission(ResourceKind.none, None, _ADMIN, browsers=True, fresh=True),
    # Accounts
    "invite_person": Permission(ResourceKind.server, None, _ADMIN),
    # With these, somebody at an admin's open browser could take over accounts.
    "create_reset_link": Permission(ResourceKind.server, None, _ADMIN, fresh=True),
    "reset_totp": Permission(ResourceKind.server, None, _ADMIN, fresh=True),
    # Audit log, home, events, service
    "list_audit_events": Permission(ResourceKind.project, Right.delete, _READ),
    "export_audit_events": Permission(ResourceKind.project, Right.delete, _READ),
    "get_home": Permission(ResourceKind.none, None, _READ),
    "get_home_storage": Permission(ResourceKind.none, None, _READ),
    "watch_events": Permission(ResourceKind.none, None, _READ),
    # The whole server
    "get_admin_storage": Permission(ResourceKind.server, None, _ADMIN),
    "get_admin_jobs": Permission(ResourceKind.server, None, _ADMIN),
    "retry_job": Permission(ResourceKind.server, None, _ADMIN),
    "retry_jobs": Permission(ResourceKind.server, None, _ADMIN),
    "get_admin_scrub": Permission(ResourceKind.server, None, _ADMIN),
    "begin_scrub": Permission(ResourceKind.server, None, _ADMIN),
    "get_admin_health": Permission(ResourceKind.server, None, _ADMIN),
    "get_admin_status": Permission(ResourceKind.server, None, _ADMIN),
    "get_admin_settings": Permission(ResourceKind.server, None, _ADMIN),
    "get_service": Permission(ResourceKind.none, None, _ANY, guests=True, runners=True),
}

# First segments of the paths of the web app, whose views are in web/src/router/routes.ts.
WEB_PATHS = (
    "account",
    "actions",
    "admin",
    "audit",
    "files",
    "groups",
    "missions",
    "people",
    "projects",
    "public",
    "run-metrics",
    "runs",
    "search",
    "sessions",
    "signed-in",
    "tokens",
    "trash",
    "upload",
)

# Public pages without authentication. They must not contain names or data of people.
OPEN_PAGES = {
    "/": "the web interface; the same for everybody",
    **{f"/{path}": "the web interface" for path in WEB_PATHS},
    **{f"/{path}/{{rest:path}}": "the web interface" for path in WEB_PATHS},
    "/assets/{name}": "scripts and styles of the web interface",
    "/fonts/{name}": "fonts of the web interface",
    "/licences.md": "licences of its dependencies",
    "/static/{name}": "styles that the server's own pages share with it",
    "/health/live": "whether the process responds",
    "/health/ready": "whether database, schema and store are available",
    "/s": "the page of share links; the same for everybody",
    "/s/static/{name}": "script and stylesheet of that page",
    "/s/view": "the viewer of share links; the same for everybody",
    "/sign-in": "sign-in page",
    "/sign-in/static/{name}": "script and stylesheet of the sign-in pages",
    "/sign-in/{name}": "other sign-in pages, without data",
}
