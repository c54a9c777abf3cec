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

# Seconds from now by the database's clock; below zero for what has expired, None for what does not.
Expiry = float | None
_SOON = "now() + make_interval(secs => %s)"


@dataclass(frozen=True)
class Person:
    """Somebody with an account, a group of their own, and a token of all scopes that their rights allow."""

    id: str
    name: str
    group_id: str
    token: str
    token_id: str


@dataclass(frozen=True)
class Token:
    """A token; `secret` is what a request carries."""

    id: str
    secret: str


def person(api: Api, name: str | None = None, *, admin: bool = False, email: str | None = None) -> Person:
    """Put a person, of any name unless one is given; `email` is verified, by nobody in particular."""
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
    """Put a group, of any name unless one is given, with members until then; returns its id."""
    group_id = str(uuid.uuid4())
    name = name or f"group {group_id[:8]}"
    values = (group_id, kind.value, name, name_key(name))
    api.sql("INSERT INTO access_group (id, kind, name, name_key) VALUES (%s, %s, %s, %s)", *values)
    for member in members:
        join(api, member, group_id, expires_s=expires_s)
    return group_id


def email_group(api: Api, email: str) -> str:
    """Put the group of an e-mail address where there is none; returns its id."""
    values = (str(uuid.uuid4()), email, name_key(email))
    api.sql(
        "INSERT INTO access_group (id, kind, name, name_key) VALUES (%s, 'email', %s, %s) ON CONFLICT DO NOTHING",
        *values,
    )
    groups = api.sql("SELECT id::text FROM access_group WHERE kind = 'email' AND name_key = %s", name_key(email))
    return str(groups[0][0])


def join(api: Api, who: Person | str, group_id: str, *, is_editor: bool = False, expires_s: Expiry = None) -> None:
    """Put somebody into a group until then, or change until when."""
    api.sql(
        f"INSERT INTO membership (group_id, person_id, is_editor, expires_at) VALUES (%s, %s, %s, {_SOON})"
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
    """Grant a right to a person's own group, or to the group of an id, in place of the one there; returns its id."""
    group_id = who.group_id if isinstance(who, Person) else who
    place = "project_id" if project_id is not None else "mission_id"
    granted = api.sql(
        f"INSERT INTO access_grant (id, group_id, {place}, level, expires_at) VALUES (%s, %s, %s, %s, {_SOON})"
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
    """Put a token; `limits` are the ids of the projects and missions that it reaches."""
    made = Token(str(uuid.uuid4()), f"test_{secrets.token_hex(32)}")
    whose = who.id if isinstance(who, Person) else who
    digest = hashlib.sha256(made.secret.encode()).digest()
    api.sql(
        "INSERT INTO token (id, person_id, kind, name, prefix, secret_sha256, scopes, is_limited, expires_at)"
        f" VALUES (%s, %s, %s, %s, %s, %s, %s, %s, {_SOON})",
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
    """Mark that somebody left, and nothing else."""
    api.sql("UPDATE person SET deactivated_at = now() WHERE id = %s", who.id)


def session(api: Api, who: Person, *, expires_s: float = 3600) -> str:
    """Put a browser's session; returns what its cookie carries."""
    secret = secrets.token_hex(32)
    api.sql(
        "INSERT INTO session (id, person_id, secret_sha256, method, expires_at)"
        f" VALUES (%s, %s, %s, 'password', {_SOON})",
        *(str(uuid.uuid4()), who.id, hashlib.sha256(secret.encode()).digest(), expires_s),
    )
    return secret


def share(api: Api, mission_id: str, *, file_ids: Sequence[str] | None = None, expires_s: float = 3600) -> Token:
    """Put a link to a mission, or to some of its files; it expires then, below zero for one that has ended."""
    made = Token(str(uuid.uuid4()), f"test_{secrets.token_hex(32)}")
    digest = hashlib.sha256(made.secret.encode()).digest()
    api.sql(
        "INSERT INTO share (id, mission_id, name, is_whole_mission, prefix, secret_sha256, created_by_id, expires_at)"
        f" VALUES (%s, %s, %s, %s, %s, %s, %s, {_SOON})",
        *(made.id, mission_id, f"link {made.id[:8]}", file_ids is None, made.secret[:12], digest, OWNER_ID, expires_s),
    )
    for file_id in file_ids or ():
        api.sql("INSERT INTO share_file (share_id, file_id) VALUES (%s, %s)", made.id, file_id)
    return made
