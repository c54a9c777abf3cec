"""People, groups, grants, tokens, sessions and shares, inserted directly into the database."""

import hashlib
import secrets
import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from kleinkram.contract.access import GroupKind, Right, Scope, TokenKind
from kleinkram.contract.names import name_key
from kleinkram.server.access.builtin_groups import ADMINS_ID, OWNER_ID
from tests.integration.api_server import Api

# Seconds from now by the database's clock; negative: already expired, None: no expiry.
Expiry = float | None
_EXPIRES_AT = "now() + make_interval(secs => %s)"


@dataclass(frozen=True)
class Person:
    """A person with an account, a personal group, and a token with the scope admin."""

    id: str
    name: str
    group_id: str
    token: str
    token_id: str


@dataclass(frozen=True)
class Token:
    """A token or link; requests authenticate with `secret`."""

    id: str
    secret: str


def person(api: Api, name: str | None = None, *, admin: bool = False, email: str | None = None) -> Person:
    """Insert a person, with a random name by default; `email` is stored as verified."""
    person_id, group_id = str(uuid.uuid4()), str(uuid.uuid4())
    name = name or f"person {person_id[:8]}"
    api.sql("INSERT INTO person (id, name) VALUES (%s, %s)", person_id, name)
    api.sql(
        "INSERT INTO access_group (id, kind, name, name_key, person_id) VALUES (%s, %s, %s, %s, %s)",
        *(group_id, GroupKind.person.value, name, name_key(name), person_id),
    )
    join(api, person_id, group_id)
    if admin:
        join(api, person_id, str(ADMINS_ID))
    if email is not None:
        api.sql(
            "INSERT INTO person_email (email_key, email, person_id, verified_at, verified_by)"
            " VALUES (%s, %s, %s, now(), 'test')",
            *(name_key(email), email, person_id),
        )
        join(api, person_id, email_group(api, email))
    made = token(api, person_id)
    return Person(person_id, name, group_id, made.secret, made.id)


def group(
    api: Api,
    name: str | None = None,
    *,
    kind: GroupKind = GroupKind.custom,
    members: Sequence[Person] = (),
    expires_s: Expiry = None,
) -> str:
    """Insert a group, with a random name by default; `expires_s` applies to its members. Return its id."""
    group_id = str(uuid.uuid4())
    name = name or f"group {group_id[:8]}"
    values = (group_id, kind.value, name, name_key(name))
    api.sql("INSERT INTO access_group (id, kind, name, name_key) VALUES (%s, %s, %s, %s)", *values)
    for member in members:
        join(api, member, group_id, expires_s=expires_s)
    return group_id


def email_group(api: Api, email: str) -> str:
    """Insert the group of an email address unless it exists; return its id."""
    values = (str(uuid.uuid4()), email, name_key(email))
    api.sql(
        "INSERT INTO access_group (id, kind, name, name_key) VALUES (%s, 'email', %s, %s) ON CONFLICT DO NOTHING",
        *values,
    )
    groups = api.sql("SELECT id::text FROM access_group WHERE kind = 'email' AND name_key = %s", name_key(email))
    return str(groups[0][0])


def join(api: Api, who: Person | str, group_id: str, *, is_editor: bool = False, expires_s: Expiry = None) -> None:
    """Add a person to a group, or change the membership."""
    api.sql(
        f"INSERT INTO membership (group_id, person_id, is_editor, expires_at) VALUES (%s, %s, %s, {_EXPIRES_AT})"
        " ON CONFLICT (group_id, person_id)"
        " DO UPDATE SET expires_at = excluded.expires_at, is_editor = excluded.is_editor",
        *(group_id, who.id if isinstance(who, Person) else who, is_editor, expires_s),
    )


def grant(
    api: Api,
    who: Person | str,
    right: Right,
    *,
    project_id: str | None = None,
    mission_id: str | None = None,
    expires_s: Expiry = None,
) -> str:
    """Grant a right to a person or a group, replacing an existing grant; return its id."""
    group_id = who.group_id if isinstance(who, Person) else who
    place = "project_id" if project_id is not None else "mission_id"
    granted = api.sql(
        f"INSERT INTO access_grant (id, group_id, {place}, level, expires_at) VALUES (%s, %s, %s, %s, {_EXPIRES_AT})"
        f" ON CONFLICT ({place}, group_id) DO UPDATE SET level = excluded.level, expires_at = excluded.expires_at"
        " RETURNING id::text",
        *(str(uuid.uuid4()), group_id, project_id or mission_id, right.level, expires_s),
    )
    return str(granted[0][0])


def token(
    api: Api,
    who: Person | str,
    scopes: Collection[Scope] = (Scope.admin,),
    *,
    limits: Sequence[str] | None = None,
    kind: TokenKind = TokenKind.personal,
    expires_s: Expiry = None,
) -> Token:
    """Insert a token; `limits` are the ids of the projects and missions that it is limited to."""
    made = Token(str(uuid.uuid4()), f"test_{secrets.token_hex(32)}")
    whose = who.id if isinstance(who, Person) else who
    digest = hashlib.sha256(made.secret.encode()).digest()
    api.sql(
        "INSERT INTO token (id, person_id, kind, name, prefix, secret_sha256, scopes, is_limited, expires_at)"
        f" VALUES (%s, %s, %s, %s, %s, %s, %s, %s, {_EXPIRES_AT})",
        *(made.id, whose, kind.value, f"token {made.id[:8]}", made.secret[:12], digest),
        *([scope.value for scope in scopes], limits is not None, expires_s),
    )
    for limit in limits or ():
        is_project = api.sql("SELECT 1 FROM project WHERE id = %s", limit)
        api.sql(
            f"INSERT INTO token_limit (id, token_id, {'project_id' if is_project else 'mission_id'})"
            " VALUES (%s, %s, %s)",
            *(str(uuid.uuid4()), made.id, limit),
        )
    return made


def revoke(api: Api, made: Token) -> None:
    """Revoke a token."""
    api.sql("UPDATE token SET revoked_at = now() WHERE id = %s", made.id)


def deactivate(api: Api, who: Person) -> None:
    """Deactivate a person in the database, without the other effects of the operation."""
    api.sql("UPDATE person SET deactivated_at = now() WHERE id = %s", who.id)


def session(api: Api, who: Person, *, expires_s: float = 3600) -> str:
    """Insert a session of a browser; return the value of its cookie."""
    secret = secrets.token_hex(32)
    api.sql(
        "INSERT INTO session (id, person_id, secret_sha256, method, expires_at)"
        f" VALUES (%s, %s, %s, 'password', {_EXPIRES_AT})",
        *(str(uuid.uuid4()), who.id, hashlib.sha256(secret.encode()).digest(), expires_s),
    )
    return secret


def share(api: Api, mission_id: str, *, file_ids: Sequence[str] | None = None, expires_s: float = 3600) -> Token:
    """Insert a share of a mission, or of some of its files; a negative `expires_s` means already expired."""
    made = Token(str(uuid.uuid4()), f"test_{secrets.token_hex(32)}")
    digest = hashlib.sha256(made.secret.encode()).digest()
    api.sql(
        "INSERT INTO share (id, mission_id, name, is_whole_mission, prefix, secret_sha256, created_by_id, expires_at)"
        f" VALUES (%s, %s, %s, %s, %s, %s, %s, {_EXPIRES_AT})",
        *(made.id, mission_id, f"link {made.id[:8]}", file_ids is None, made.secret[:12], digest, OWNER_ID, expires_s),
    )
    for file_id in file_ids or ():
        api.sql("INSERT INTO share_file (share_id, file_id) VALUES (%s, %s)", made.id, file_id)
    return made
