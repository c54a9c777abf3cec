"""What each operation may answer other than well: from here the API's description says it, code by code.

An answer that is not described is a fault: tests hold every answer that they get to the description.
"""

from typing import Any

from kleinkram.contract.errors import (
    BodyTooLarge,
    CodeGone,
    DatabaseUnavailable,
    EditConflict,
    FileUnavailable,
    Forbidden,
    GroupFixed,
    InternalError,
    InvalidCursor,
    InvalidQuery,
    InvalidRequest,
    KleinkramError,
    LastAdmin,
    LastOwner,
    LastSignInMethod,
    NameTaken,
    NoInputs,
    NoRunner,
    NotAuthenticated,
    NotFound,
    PathConflict,
    ProviderUnavailable,
    QuotaExceeded,
    RateLimited,
    RightExceeded,
    RunGone,
    ScopeMissing,
    SecondFactorNeeded,
    SecondFactorWrong,
    SignInDenied,
    SignInExpired,
    SignInFailed,
    SignInPending,
    SignInRefused,
    SignInTooOld,
    SlowDown,
    StoreUnavailable,
    TokenTooWide,
    TooManyStreams,
    UploadGone,
    YamlInvalid,
)
from kleinkram.contract.errors import FieldsInvalid as FieldsWrong
from kleinkram.contract.errors import MetadataInvalid as MetadataWrong
from kleinkram.server.access.operations import OPERATIONS, On

Failure = type[KleinkramError]

_ALWAYS: tuple[Failure, ...] = (NotAuthenticated, ScopeMissing, InternalError, DatabaseUnavailable)
_LISTED: tuple[Failure, ...] = (InvalidQuery, InvalidCursor, RateLimited)
_FIELDS: tuple[Failure, ...] = (NameTaken, YamlInvalid, FieldsWrong)
_METADATA: tuple[Failure, ...] = (NameTaken, YamlInvalid, MetadataWrong)
_GIVING: tuple[Failure, ...] = (RightExceeded, LastOwner)
_MEMBERS: tuple[Failure, ...] = (GroupFixed, LastOwner, LastAdmin)
_KNOCKING: tuple[Failure, ...] = (SignInFailed, SignInRefused, CodeGone, NotFound, RateLimited, SlowDown)
_SECOND: tuple[Failure, ...] = (SecondFactorNeeded, SecondFactorWrong)

# Beside what any operation may answer, and what follows from the right that it takes.
FAILURES: dict[str, tuple[Failure, ...]] = {
    "list_projects": _LISTED,
    "create_project": (*_FIELDS, Forbidden),
    "update_project": (*_FIELDS, EditConflict),
    "create_mission": _METADATA,
    "list_missions": _LISTED,
    "update_mission": (*_METADATA, QuotaExceeded, EditConflict),
    "list_recordings": (InvalidCursor,),
    "get_project_stats": (InvalidQuery, RateLimited),
    "get_overview": (InvalidQuery, RateLimited),
    "list_mission_topics": (InvalidCursor,),
    "get_mission_timeline": (InvalidCursor,),
    "list_files": _LISTED,
    "download_files": (FileUnavailable, RateLimited),
    "list_file_topics": (InvalidCursor,),
    "prove_file": (RateLimited,),
    "update_file": (NameTaken, PathConflict, QuotaExceeded, EditConflict),
    "search": (InvalidQuery, RateLimited),
    "get_facets": (InvalidQuery, RateLimited),
    "list_topics": _LISTED,
    "get_stats": (InvalidQuery, RateLimited),
    "begin_uploads": (QuotaExceeded, RateLimited, StoreUnavailable),
    "list_uploads": (InvalidCursor,),
    "get_upload": (StoreUnavailable,),
    "sign_parts": (UploadGone,),
    "complete_uploads": (StoreUnavailable,),
    "list_actions": (InvalidCursor,),
    "create_action": (NameTaken,),
    "update_action": (NameTaken, EditConflict),
    "publish_action_version": (EditConflict,),
    "list_action_versions": (InvalidCursor,),
    "list_runs": (InvalidCursor,),
    "retry_run": (NoInputs, NoRunner, FileUnavailable),
    "list_run_inputs": (InvalidCursor,),
    "list_artifacts": (InvalidCursor,),
    "download_artifacts": (FileUnavailable,),
    "get_run_log": (StoreUnavailable, TooManyStreams),
    "list_findings": (InvalidCursor, NotFound),
    "list_run_metrics": (InvalidCursor, NotFound),
    "list_runners": (InvalidCursor,),
    "say_hello": (Forbidden,),
    "claim_run": (NotFound, Forbidden, TooManyStreams),
    "beat": (NotFound, Forbidden),
    "get_run_context": (RunGone,),
    "sign_inputs": (RunGone, NotFound),
    "sign_log_segment": (RunGone,),
    "keep_log_segment": (RunGone,),
    "begin_artifacts": (RunGone, StoreUnavailable),
    "finish_run": (RunGone,),
    "list_project_grants": (InvalidCursor,),
    "list_mission_grants": (InvalidCursor,),
    "create_project_grant": _GIVING,
    "create_mission_grant": _GIVING,
    "update_project_grant": _GIVING,
    "update_mission_grant": _GIVING,
    "delete_project_grant": (LastOwner,),
    "delete_mission_grant": (LastOwner,),
    "get_project_access": (InvalidCursor,),
    "get_mission_access": (InvalidCursor,),
    "list_groups": (InvalidCursor,),
    "create_group": (NameTaken, Forbidden),
    "get_group": (NotFound,),
    "update_group": (NotFound, Forbidden, NameTaken, GroupFixed, EditConflict),
    "delete_group": (NotFound, Forbidden, *_MEMBERS),
    "list_group_members": (NotFound, InvalidCursor),
    "set_group_member": (NotFound, Forbidden, RightExceeded, EditConflict, *_MEMBERS),
    "remove_group_member": (NotFound, Forbidden, *_MEMBERS),
    "list_people": (InvalidCursor,),
    "get_person": (NotFound,),
    "make_admin": (NotFound,),
    "unmake_admin": (NotFound, LastAdmin),
    "deactivate_person": (NotFound, LastAdmin),
    "reactivate_person": (NotFound,),
    "list_trash": (InvalidCursor,),
    "restore_from_trash": (NameTaken, PathConflict, QuotaExceeded),
    "create_token": (NotFound, Forbidden, TokenTooWide, SignInTooOld),
    "list_tokens": (Forbidden, InvalidCursor),
    "revoke_token": (NotFound,),
    "list_shares": (InvalidCursor,),
    "get_share": (NotFound,),
    "sign_in_by_password": (*_KNOCKING, *_SECOND),
    "sign_in_by_link": _KNOCKING,
    "look_at_code": (CodeGone, RateLimited),
    "accept_invitation": (*_KNOCKING, NameTaken),
    "reset_password": (*_KNOCKING, *_SECOND),
    "claim_server": (*_KNOCKING, NameTaken),
    "begin_provider_sign_in": (NotFound, ProviderUnavailable, RateLimited),
    "begin_device_login": (RateLimited,),
    "exchange_device_code": (SignInPending, SlowDown, SignInDenied, SignInExpired, SignInRefused, RateLimited),
    "exchange_cli_code": (SignInExpired, SignInRefused, RateLimited),
    "list_sessions": (InvalidCursor,),
    "end_session": (NotFound,),
    "unlink_identity": (NotFound, LastSignInMethod),
    "create_owner_link": (Forbidden,),
    "change_password": _KNOCKING,
    "link_provider": (NotFound, ProviderUnavailable, RateLimited),
    "approve_cli_login": (RateLimited,),
    "look_at_device_login": (CodeGone, RateLimited),
    "approve_device_login": (CodeGone, RateLimited),
    "deny_device_login": (CodeGone, RateLimited),
    "prove_password_again": (*_KNOCKING, *_SECOND),
    "begin_provider_sign_in_again": (NotFound, ProviderUnavailable, RateLimited),
    "begin_totp": (Forbidden, NameTaken),
    "confirm_totp": (NotFound, RateLimited, SecondFactorWrong),
    "disable_totp": (NotFound,),
    "renew_recovery_codes": (NotFound,),
    "reset_totp": (NotFound,),
    "invite_person": (NameTaken, Forbidden),
    "create_reset_link": (NotFound, Forbidden),
    "list_audit_events": (InvalidCursor,),
    "retry_job": (NotFound,),
    "watch_events": (TooManyStreams,),
    "export_audit_events": (RateLimited,),
}


def failures_of(operation: str, *, takes_input: bool, takes_body: bool) -> list[Failure]:
    """Return what an operation may answer other than well, each once."""
    need = OPERATIONS[operation]
    found = [*_ALWAYS, *FAILURES.get(operation, ())]
    if need.on in {On.project, On.mission}:
        found += [NotFound, Forbidden]
    elif need.on is On.server:
        found += [Forbidden]
    found += [SignInTooOld] if need.fresh else []
    found += [InvalidRequest] if takes_input else []
    found += [BodyTooLarge] if takes_body else []
    return list(dict.fromkeys(found))


def described(schema: dict[str, Any]) -> dict[str, Any]:
    """Return an OpenAPI document with the problems that each of its operations may answer, by status and code."""
    paths = {path: {method: _completed(row) for method, row in rows.items()} for path, rows in schema["paths"].items()}
    schemas = schema["components"]["schemas"]
    kept = {name: each for name, each in schemas.items() if name not in {"HTTPValidationError", "ValidationError"}}
    return {**schema, "paths": paths, "components": {**schema["components"], "schemas": kept}}


def _completed(operation: dict[str, Any]) -> dict[str, Any]:
    takes_body = "requestBody" in operation
    found = failures_of(
        operation["operationId"], takes_input=takes_body or "parameters" in operation, takes_body=takes_body
    )
    by_status: dict[int, list[str]] = {}
    for each in found:
        by_status.setdefault(each.status, []).append(each.code.value)
    well = {status: answer for status, answer in operation["responses"].items() if status.startswith("2")}
    ill = {str(status): _problem(codes) for status, codes in sorted(by_status.items())}
    return {**operation, "responses": {**well, **ill}}


def _problem(codes: list[str]) -> dict[str, Any]:
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}}
    return {"description": f"A failure, by its code: {', '.join(codes)}.", "content": content}
