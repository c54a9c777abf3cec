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
    filled,
    get,
    has_items,
    lists,
    new_name,
    post,
    sets,
)
from tests.integration.access.expectations import About
from tests.integration.access.world import Principal

_READ, _WRITE = 1, 3
_ROLES = {About.edited_group: True, About.joined_group: False}


def _new_group(by: Principal, about: About) -> tuple[str, str]:
    """Put a group that the principal edits, is in, or is not in; returns its id and its name."""
    name = new_name()
    group_id = people.group(by.api, name)
    if by.person_id is not None and about in _ROLES:
        people.join(by.api, by.person_id, group_id, is_editor=_ROLES[about])
    people.join(by.api, str(OWNER_ID), group_id)
    return group_id, name


def _of_group(method: str, path: str, *, needs: int, body: Callable[[], Any] = lambda: None) -> tuple[Caller, ...]:
    """Return a caller each for a group that one edits, is in, and is not in; `{person}` is one of its members."""

    def caller(about: About) -> Caller:
        def request(by: Principal) -> Request:
            group_id, _ = _new_group(by, about)
            return Request(method, path.format(group=group_id, person=OWNER_ID), body())

        return Caller(request, about, needs=needs)

    return tuple(caller(about) for about in (*_ROLES, About.other_group))


def _list_groups(about: About) -> Caller:
    def request(by: Principal) -> Request:
        return Request("GET", "/groups", query=(("name", _new_group(by, about)[1]),))

    return Caller(request, about, needs=_READ, shows=has_items)


def _new_email() -> str:
    return f"{uuid.uuid4().hex}@lab.test"


def _grant(_: Principal) -> Any:
    return {"email": _new_email(), "right": Right.read.value}


def _on_new_grant(method: str, resource_type: str, body: Any = None) -> Callable[[Principal], Request]:
    """Ask for something to be done with a grant that was made for it."""

    def request(by: Principal) -> Request:
        place = filled(f"{{{resource_type}}}", by)
        to = people.email_group(by.api, _new_email())
        of = (place, None) if resource_type == "project" else (None, place)
        grant_id = people.grant(by.api, to, Right.read, project_id=of[0], mission_id=of[1])
        return Request(method, f"/{resource_type}s/{place}/grants/{grant_id}", body)

    return request


def _end_session(by: Principal) -> Request:
    session_id = str(uuid.uuid4())
    if by.person_id is not None:
        by.api.sql(
            "INSERT INTO session (id, person_id, secret_sha256, method, expires_at)"
            " VALUES (%s, %s, sha256(%s::text::bytea), 'link', now() + interval '1 hour')",
            *(session_id, by.person_id, session_id),
        )
    return Request("DELETE", f"/me/sessions/{session_id}")


def _unlink_identity(by: Principal) -> Request:
    """Put an identity that is not the last way in: there is a password beside it."""
    identity_id = str(uuid.uuid4())
    if by.person_id is not None:
        by.api.sql(
            "INSERT INTO identity (id, person_id, issuer, subject) VALUES (%s, %s, 'https://id.example', %s)",
            *(identity_id, by.person_id, identity_id),
        )
        by.api.sql(
            "INSERT INTO password (person_id, hash) VALUES (%s, '$argon2id$none') ON CONFLICT DO NOTHING", by.person_id
        )
        by.api.sql(
            "INSERT INTO person_email (email_key, email, person_id, verified_at, verified_by)"
            " VALUES (%s, %s, %s, now(), 'unlinking')",
            *(f"{identity_id}@lab.test", f"{identity_id}@lab.test", by.person_id),
        )
    return Request("DELETE", f"/me/identities/{identity_id}")


def _forget_ways_in(by: Principal) -> None:
    by.api.sql("DELETE FROM identity WHERE person_id = %s", by.person_id)
    by.api.sql("DELETE FROM password WHERE person_id = %s AND hash = '$argon2id$none'", by.person_id)
    by.api.sql("DELETE FROM person_email WHERE person_id = %s AND verified_by = 'unlinking'", by.person_id)


def _begin_sessions_again(by: Principal) -> None:
    by.api.sql("UPDATE session SET revoked_at = NULL WHERE person_id = %s", by.person_id)


def _revoke_token(by: Principal) -> Request:
    made = people.token(by.api, by.person_id or str(OWNER_ID))
    return Request("DELETE", f"/tokens/{made.id}")


def _share(_: Principal) -> Any:
    tomorrow = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=1)
    return {"name": "a link", "expires_at": tomorrow.isoformat()}


def _loopback(_: Principal) -> Any:
    return {"port": 8080, "state": "12345678", "code_challenge": "x" * 43}


def _code(_: Principal) -> Any:
    return {"user_code": "NOBODYHASIT"}


_PASSWORDS = {"old_password": "never it was", "new_password": "nor will it be"}

OF_PEOPLE: dict[str, tuple[Caller, ...]] = {
    "list_project_grants": (Caller(get("/projects/{project}/grants"), About.project),),
    "list_mission_grants": (Caller(get("/missions/{mission}/grants"), About.mission),),
    "create_project_grant": (Caller(post("/projects/{project}/grants", _grant), About.project),),
    "create_mission_grant": (Caller(post("/missions/{mission}/grants", _grant), About.mission),),
    "update_project_grant": (Caller(_on_new_grant("PATCH", "project", {"right": "READ"}), About.project),),
    "update_mission_grant": (Caller(_on_new_grant("PATCH", "mission", {"right": "READ"}), About.mission),),
    "delete_project_grant": (Caller(_on_new_grant("DELETE", "project"), About.project),),
    "delete_mission_grant": (Caller(_on_new_grant("DELETE", "mission"), About.mission),),
    "get_project_access": (Caller(get("/projects/{project}/access"), About.project),),
    "get_mission_access": (Caller(get("/missions/{mission}/access"), About.mission),),
    "list_groups": tuple(_list_groups(about) for about in (*_ROLES, About.other_group)),
    "create_group": (Caller(post("/groups", lambda _: {"name": new_name()}), About.server, is_boundless=True),),
    "get_group": _of_group("GET", "/groups/{group}", needs=_READ),
    "update_group": _of_group("PATCH", "/groups/{group}", needs=_WRITE, body=lambda: {"name": new_name()}),
    "delete_group": _of_group("DELETE", "/groups/{group}", needs=_WRITE),
    "list_group_members": _of_group("GET", "/groups/{group}/members", needs=_READ),
    "set_group_member": _of_group(
        "PUT", "/groups/{group}/members/{person}", needs=_WRITE, body=lambda: {"is_editor": True}
    ),
    "remove_group_member": _of_group("DELETE", "/groups/{group}/members/{person}", needs=_WRITE),
    "list_people": (Caller(get("/people", text="{hermit_name}"), About.hermit, shows=lists("hermit")),),
    "get_person": (Caller(get("/people/{hermit}"), About.hermit, needs=_READ),),
    "make_admin": (
        Caller(
            post("/people/{hermit}/admin"),
            About.server,
            undo=sets(
                f"DELETE FROM membership WHERE person_id = %s AND group_id = '{ADMINS_ID}'",
                "hermit",
            ),
        ),
    ),
    "unmake_admin": (Caller(delete("/people/{hermit}/admin"), About.server),),
    "deactivate_person": (
        Caller(
            post("/people/{hermit}/deactivate"),
            About.server,
            undo=sets("UPDATE person SET deactivated_at = NULL WHERE id = %s", "hermit"),
        ),
    ),
    "reactivate_person": (Caller(post("/people/{hermit}/reactivate"), About.server),),
    "create_token": (Caller(post("/tokens", lambda _: {"name": "another"}), About.server, is_boundless=True),),
    "list_tokens": (Caller(get("/tokens"), About.server),),
    "revoke_token": (Caller(_revoke_token, About.server, scopes=frozenset({Scope.admin}), is_boundless=True),),
    "create_share": (Caller(post("/missions/{mission}/shares", _share), About.mission),),
    "list_shares": (Caller(get("/shares", mission_id="{mission}", limit="500"), About.mission, shows=lists("link")),),
    "revoke_share": (
        Caller(
            delete("/shares/{link}"),
            About.mission,
            undo=sets("UPDATE share SET revoked_at = NULL WHERE id = %s", "link"),
        ),
    ),
    "get_share": (Caller(get("/share"), About.link, needs=_READ),),
    "get_me": (Caller(get("/me"), About.server),),
    "list_sessions": (Caller(get("/me/sessions"), About.server),),
    "end_session": (Caller(_end_session, About.server),),
    "end_all_sessions": (Caller(delete("/me/sessions"), About.server, undo=_begin_sessions_again),),
    "get_account": (Caller(get("/me/account"), About.server),),
    "list_identities": (Caller(get("/me/identities"), About.server),),
    "unlink_identity": (Caller(_unlink_identity, About.server, undo=_forget_ways_in),),
    "create_owner_link": (Caller(post("/auth/owner-link"), About.owner, needs=_READ),),
    "change_password": (
        Caller(post("/auth/password/change", lambda _: _PASSWORDS), About.server, passes="sign_in_failed"),
    ),
    "link_provider": (Caller(post("/auth/providers/none/link", lambda _: {}), About.server, passes="not_found"),),
    "approve_cli_login": (Caller(post("/auth/cli/approve", _loopback), About.server),),
    "get_device_login": (Caller(post("/auth/device/status", _code), About.server, passes="code_gone"),),
    "approve_device_login": (Caller(post("/auth/device/approve", _code), About.server, passes="code_gone"),),
    "deny_device_login": (Caller(post("/auth/device/deny", _code), About.server, passes="code_gone"),),
    "invite_person": (Caller(post("/people/invitations", lambda _: {"email": _new_email()}), About.server),),
    "create_reset_link": (Caller(post("/people/{hermit}/reset"), About.server),),
    "reset_totp": (Caller(delete("/people/{hermit}/totp"), About.server, passes="not_found"),),
    "reauthenticate_by_password": (
        Caller(
            post("/auth/password/reauthenticate", lambda _: {"password": "any"}), About.server, passes="sign_in_failed"
        ),
    ),
    "begin_provider_reauthentication": (
        Caller(post("/auth/providers/none/reauthenticate", lambda _: {}), About.server, passes="not_found"),
    ),
    "begin_totp": (Caller(post("/me/totp"), About.server, passes="forbidden"),),
    "confirm_totp": (Caller(post("/me/totp/confirm", lambda _: {"code": "000000"}), About.server, passes="not_found"),),
    "renew_recovery_codes": (Caller(post("/me/totp/recovery-codes"), About.server, passes="not_found"),),
    "disable_totp": (Caller(delete("/me/totp"), About.server, passes="not_found"),),
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
    "begin_device_login",
    "exchange_device_code",
    "exchange_cli_code",
    "sign_out",
    "get_service",
}
