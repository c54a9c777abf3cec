"""How the matrix calls each operation on people, groups, rights, tokens, shares and sign-ins."""

import datetime
import uuid
from collections.abc import Callable
from typing import Any

from kleinkram.contract.access import Right, Scope
from kleinkram.server.access.builtin_groups import ADMINS_ID, OWNER_ID
from tests.integration import people
from tests.integration.access.call import (
    Caller,
    Request,
    delete,
    fill,
    get,
    has_items,
    lists,
    new_name,
    post,
    sets,
)
from tests.integration.access.expectations import Target
from tests.integration.access.world import Principal

_READ, _WRITE = 1, 3
_ROLES = {Target.edited_group: True, Target.joined_group: False}


def _new_group(principal: Principal, target: Target) -> tuple[str, str]:
    """Insert a group that the principal edits, is a member of, or is not a member of; return its id and name."""
    name = new_name()
    group_id = people.group(principal.api, name)
    if principal.person_id is not None and target in _ROLES:
        people.join(principal.api, principal.person_id, group_id, is_editor=_ROLES[target])
    people.join(principal.api, str(OWNER_ID), group_id)
    return group_id, name


def _of_group(
    method: str, path: str, *, required_level: int, body: Callable[[], Any] = lambda: None
) -> tuple[Caller, ...]:
    """Return callers for a group that the principal edits, is a member of, and is not; `{person}` is a member."""

    def caller(target: Target) -> Caller:
        def request(principal: Principal) -> Request:
            group_id, _ = _new_group(principal, target)
            return Request(method, path.format(group=group_id, person=OWNER_ID), body())

        return Caller(request, target, required_level=required_level)

    return tuple(caller(target) for target in (*_ROLES, Target.other_group))


def _list_groups(target: Target) -> Caller:
    def request(principal: Principal) -> Request:
        return Request("GET", "/groups", query=(("name", _new_group(principal, target)[1]),))

    return Caller(request, target, required_level=_READ, shows=has_items)


def _new_email() -> str:
    return f"{uuid.uuid4().hex}@lab.test"


def _grant(_: Principal) -> Any:
    return {"email": _new_email(), "right": Right.read.value}


def _on_new_grant(method: str, resource_type: str, body: Any = None) -> Callable[[Principal], Request]:
    """Return a request that changes a new grant."""

    def request(principal: Principal) -> Request:
        place = fill(f"{{{resource_type}}}", principal)
        to = people.email_group(principal.api, _new_email())
        of = (place, None) if resource_type == "project" else (None, place)
        grant_id = people.grant(principal.api, to, Right.read, project_id=of[0], mission_id=of[1])
        return Request(method, f"/{resource_type}s/{place}/grants/{grant_id}", body)

    return request


def _end_session(principal: Principal) -> Request:
    session_id = str(uuid.uuid4())
    if principal.person_id is not None:
        principal.api.sql(
            "INSERT INTO session (id, person_id, secret_sha256, method, expires_at)"
            " VALUES (%s, %s, sha256(%s::text::bytea), 'link', now() + interval '1 hour')",
            *(session_id, principal.person_id, session_id),
        )
    return Request("DELETE", f"/me/sessions/{session_id}")


def _unlink_identity(principal: Principal) -> Request:
    """Insert an identity, and a password, because the last sign-in method cannot be unlinked."""
    identity_id = str(uuid.uuid4())
    if principal.person_id is not None:
        principal.api.sql(
            "INSERT INTO identity (id, person_id, issuer, subject) VALUES (%s, %s, 'https://id.example', %s)",
            *(identity_id, principal.person_id, identity_id),
        )
        principal.api.sql(
            "INSERT INTO password (person_id, hash) VALUES (%s, '$argon2id$none') ON CONFLICT DO NOTHING",
            principal.person_id,
        )
        principal.api.sql(
            "INSERT INTO person_email (email_key, email, person_id, verified_at, verified_by)"
            " VALUES (%s, %s, %s, now(), 'unlinking')",
            *(f"{identity_id}@lab.test", f"{identity_id}@lab.test", principal.person_id),
        )
    return Request("DELETE", f"/me/identities/{identity_id}")


def _delete_sign_in_methods(principal: Principal) -> None:
    principal.api.sql("DELETE FROM identity WHERE person_id = %s", principal.person_id)
    principal.api.sql("DELETE FROM password WHERE person_id = %s AND hash = '$argon2id$none'", principal.person_id)
    principal.api.sql(
        "DELETE FROM person_email WHERE person_id = %s AND verified_by = 'unlinking'", principal.person_id
    )


def _restore_sessions(principal: Principal) -> None:
    principal.api.sql("UPDATE session SET revoked_at = NULL WHERE person_id = %s", principal.person_id)


def _revoke_token(principal: Principal) -> Request:
    made = people.token(principal.api, principal.person_id or str(OWNER_ID))
    return Request("DELETE", f"/tokens/{made.id}")


def _share(_: Principal) -> Any:
    tomorrow = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=1)
    return {"name": "a link", "expires_at": tomorrow.isoformat()}


def _loopback(_: Principal) -> Any:
    return {"port": 8080, "state": "12345678", "code_challenge": "x" * 43}


def _code(_: Principal) -> Any:
    return {"user_code": "UNKNOWNCODE"}


_PASSWORDS = {"old_password": "a wrong password", "new_password": "another password"}

PEOPLE_OPERATIONS: dict[str, tuple[Caller, ...]] = {
    "list_project_grants": (Caller(get("/projects/{project}/grants"), Target.project),),
    "list_mission_grants": (Caller(get("/missions/{mission}/grants"), Target.mission),),
    "create_project_grant": (Caller(post("/projects/{project}/grants", _grant), Target.project),),
    "create_mission_grant": (Caller(post("/missions/{mission}/grants", _grant), Target.mission),),
    "update_project_grant": (Caller(_on_new_grant("PATCH", "project", {"right": "READ"}), Target.project),),
    "update_mission_grant": (Caller(_on_new_grant("PATCH", "mission", {"right": "READ"}), Target.mission),),
    "delete_project_grant": (Caller(_on_new_grant("DELETE", "project"), Target.project),),
    "delete_mission_grant": (Caller(_on_new_grant("DELETE", "mission"), Target.mission),),
    "get_project_access": (Caller(get("/projects/{project}/access"), Target.project),),
    "get_mission_access": (Caller(get("/missions/{mission}/access"), Target.mission),),
    "list_groups": tuple(_list_groups(target) for target in (*_ROLES, Target.other_group)),
    "create_group": (
        Caller(post("/groups", lambda _: {"name": new_name()}), Target.server, needs_unlimited_credential=True),
    ),
    "get_group": _of_group("GET", "/groups/{group}", required_level=_READ),
    "update_group": _of_group("PATCH", "/groups/{group}", required_level=_WRITE, body=lambda: {"name": new_name()}),
    "delete_group": _of_group("DELETE", "/groups/{group}", required_level=_WRITE),
    "list_group_members": _of_group("GET", "/groups/{group}/members", required_level=_READ),
    "set_group_member": _of_group(
        "PUT", "/groups/{group}/members/{person}", required_level=_WRITE, body=lambda: {"is_editor": True}
    ),
    "remove_group_member": _of_group("DELETE", "/groups/{group}/members/{person}", required_level=_WRITE),
    "list_people": (
        Caller(
            get("/people", text="{unrelated_person_name}"), Target.unrelated_person, shows=lists("unrelated_person")
        ),
    ),
    "get_person": (Caller(get("/people/{unrelated_person}"), Target.unrelated_person, required_level=_READ),),
    "make_admin": (
        Caller(
            post("/people/{unrelated_person}/admin"),
            Target.server,
            undo=sets(
                f"DELETE FROM membership WHERE person_id = %s AND group_id = '{ADMINS_ID}'",
                "unrelated_person",
            ),
        ),
    ),
    "unmake_admin": (Caller(delete("/people/{unrelated_person}/admin"), Target.server),),
    "deactivate_person": (
        Caller(
            post("/people/{unrelated_person}/deactivate"),
            Target.server,
            undo=sets("UPDATE person SET deactivated_at = NULL WHERE id = %s", "unrelated_person"),
        ),
    ),
    "reactivate_person": (Caller(post("/people/{unrelated_person}/reactivate"), Target.server),),
    "erase_person": (
        Caller(
            post("/people/{unrelated_person}/erase", lambda _: {"confirmation": "another name"}),
            Target.server,
            accepted_code="invalid_request",
        ),
    ),
    "get_erasure": (Caller(get("/people/{unrelated_person}/erasure"), Target.server, accepted_code="not_found"),),
    "export_person": (Caller(get("/people/{unrelated_person}/export"), Target.unrelated_person),),
    "create_token": (
        Caller(post("/tokens", lambda _: {"name": "another"}), Target.server, needs_unlimited_credential=True),
    ),
    "list_tokens": (Caller(get("/tokens"), Target.server),),
    "revoke_token": (
        Caller(_revoke_token, Target.server, scopes=frozenset({Scope.admin}), needs_unlimited_credential=True),
    ),
    "create_share": (Caller(post("/missions/{mission}/shares", _share), Target.mission),),
    "list_shares": (Caller(get("/shares", mission_id="{mission}", limit="500"), Target.mission, shows=lists("link")),),
    "revoke_share": (
        Caller(
            delete("/shares/{link}"),
            Target.mission,
            undo=sets("UPDATE share SET revoked_at = NULL WHERE id = %s", "link"),
        ),
    ),
    "get_share": (Caller(get("/share"), Target.link, required_level=_READ),),
    "get_me": (Caller(get("/me"), Target.server),),
    "list_sessions": (Caller(get("/me/sessions"), Target.server),),
    "end_session": (Caller(_end_session, Target.server),),
    "end_all_sessions": (Caller(delete("/me/sessions"), Target.server, undo=_restore_sessions),),
    "get_account": (Caller(get("/me/account"), Target.server),),
    "list_identities": (Caller(get("/me/identities"), Target.server),),
    "unlink_identity": (Caller(_unlink_identity, Target.server, undo=_delete_sign_in_methods),),
    "create_owner_link": (Caller(post("/auth/owner-link"), Target.owner, required_level=_READ),),
    "change_password": (
        Caller(post("/auth/password/change", lambda _: _PASSWORDS), Target.server, accepted_code="sign_in_failed"),
    ),
    "link_provider": (
        Caller(post("/auth/providers/none/link", lambda _: {}), Target.server, accepted_code="not_found"),
    ),
    "approve_cli_login": (Caller(post("/auth/cli/approve", _loopback), Target.server),),
    "get_device_login": (Caller(post("/auth/device/status", _code), Target.server, accepted_code="code_gone"),),
    "approve_device_login": (Caller(post("/auth/device/approve", _code), Target.server, accepted_code="code_gone"),),
    "deny_device_login": (Caller(post("/auth/device/deny", _code), Target.server, accepted_code="code_gone"),),
    "invite_person": (Caller(post("/people/invitations", lambda _: {"email": _new_email()}), Target.server),),
    "create_reset_link": (Caller(post("/people/{unrelated_person}/reset"), Target.server),),
    "reset_totp": (Caller(delete("/people/{unrelated_person}/totp"), Target.server, accepted_code="not_found"),),
    "reauthenticate_by_password": (
        Caller(
            post("/auth/password/reauthenticate", lambda _: {"password": "any"}),
            Target.server,
            accepted_code="sign_in_failed",
        ),
    ),
    "begin_provider_reauthentication": (
        Caller(post("/auth/providers/none/reauthenticate", lambda _: {}), Target.server, accepted_code="not_found"),
    ),
    "begin_totp": (Caller(post("/me/totp"), Target.server, accepted_code="forbidden"),),
    "confirm_totp": (
        Caller(post("/me/totp/confirm", lambda _: {"code": "000000"}), Target.server, accepted_code="not_found"),
    ),
    "renew_recovery_codes": (Caller(post("/me/totp/recovery-codes"), Target.server, accepted_code="not_found"),),
    "disable_totp": (Caller(delete("/me/totp"), Target.server, accepted_code="not_found"),),
}
# Public endpoints without an object; tests/integration/auth tests their responses.
PUBLIC_OPERATIONS = {
    "list_sign_in_methods",
    "sign_in_by_password",
    "sign_in_by_link",
    "get_code",
    "accept_invitation",
    "reset_password",
    "bootstrap_admin",
    "begin_provider_sign_in",
    "end_provider_sign_in",
    "end_provider_sessions",
    "begin_device_login",
    "exchange_device_code",
    "exchange_cli_code",
    "sign_out",
    "get_service",
}
