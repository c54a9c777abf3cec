"""Exports of all that is kept of a person, for them or for an admin: record by record, without secrets.

Files and missions appear by name, not with their content, which belongs to the lab.
"""

import uuid
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import JsonValue
from pydantic_core import to_jsonable_python
from sqlalchemy import ColumnElement, Select, Table, case, func, literal, or_, select

from kleinkram.contract.errors import NotFound
from kleinkram.contract.people import DataSection, PersonalData
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, Database
from kleinkram.server.people.mentions import find_mentions
from kleinkram.server.tables import (
    access_grant,
    access_group,
    action,
    action_version,
    audit_event,
    check_acceptance,
    check_note,
    check_report,
    file,
    identity,
    login_request,
    membership,
    mission,
    mission_event,
    one_time_code,
    password,
    person,
    person_email,
    project,
    run,
    runner,
    session,
    share,
    token,
    totp,
    upload,
    viewer_layout,
)

_BATCH = 500
_ORIGIN = ("token_id", "session_id", "address")
_INVITED = ("email", "name")


@dataclass(frozen=True)
class _Source:
    """Rows of a section: a select, and the column with distinct values in whose order they are read."""

    section: DataSection
    stmt: Select[Any]
    key: ColumnElement[Any]


async def begin_export(db: Connection, actor: Actor, person_id: uuid.UUID) -> None:
    """Audit that the actor exports a person's data. Raises NotFound if it is neither theirs nor are they an admin."""
    name = (await db.execute(select(person.c.name).where(person.c.id == person_id))).scalar_one_or_none()
    if name is None or not (actor.is_admin or actor.person_id == person_id):
        raise NotFound(resource_type="person", ref=str(person_id))
    is_other = actor.person_id != person_id
    await audit(db, actor, Event("person.export", "person", person_id, name, needs_admin=is_other))


async def export_person(database: Database, actor: Actor, person_id: uuid.UUID) -> AsyncIterator[PersonalData]:
    """Yield all records of a person in the order of `DataSection`, with at most `_BATCH` in memory.

    Of texts that mention them, only those that the actor may see: somebody who chose the name of a project as their own
    must not learn what mentions it. Each batch has its own transaction, so that a slow reader holds no connection.
    """
    sources = _sources(person_id)
    for section in DataSection:
        if section is DataSection.mentions:
            async for record in _mentions(database, actor, person_id):
                yield record
        for source in (source for source in sources if source.section is section):
            async for record in _read(database, source):
                yield record


async def _read(database: Database, source: _Source) -> AsyncIterator[PersonalData]:
    last: Any = None
    while True:
        stmt = source.stmt.add_columns(source.key.label("_key")).order_by(source.key).limit(_BATCH)
        stmt = stmt if last is None else stmt.where(source.key > last)
        async with database.begin() as db:
            rows = (await db.execute(stmt)).mappings().all()
        for row in rows:
            yield _record(source.section, {name: value for name, value in row.items() if name != "_key"})
        if len(rows) < _BATCH:
            return
        last = rows[-1]["_key"]


async def _mentions(database: Database, actor: Actor, person_id: uuid.UUID) -> AsyncIterator[PersonalData]:
    addresses = select(person_email.c.email).where(person_email.c.person_id == person_id)
    names = select(person.c.name).where(person.c.id == person_id, person.c.erased_at.is_(None))
    async with database.begin() as db:
        terms = [*(await db.execute(names)).scalars(), *(await db.execute(addresses)).scalars()]
        mentions = await find_mentions(db, terms, visible_to=None if actor.is_admin else actor)
    for mention in mentions:
        yield _record(DataSection.mentions, mention.model_dump(mode="json"))


def _record(section: DataSection, values: Mapping[str, object]) -> PersonalData:
    record: dict[str, JsonValue] = to_jsonable_python(values, bytes_mode="base64")
    return PersonalData(section=section, record=record)


def _columns(table: Table, *without: str) -> list[ColumnElement[Any]]:
    return [column for column in table.c if column.name not in without]


def _sources(person_id: uuid.UUID) -> list[_Source]:
    return [*_account(person_id), *_access(person_id), *_work(person_id), *_history(person_id)]


def _of(section: DataSection, table: Table, column: str, person_id: uuid.UUID, *without: str) -> _Source:
    """Return the rows of a table that refer to a person in a column."""
    return _Source(section, select(*_columns(table, *without)).where(table.c[column] == person_id), table.c.id)


def _account(person_id: uuid.UUID) -> list[_Source]:
    own_addresses = select(person_email.c.email_key).where(person_email.c.person_id == person_id)
    is_own = or_(one_time_code.c.person_id == person_id, func.lower(one_time_code.c.email).in_(own_addresses))
    # Without the addresses and names of others whom they invited.
    about = [case((is_own, one_time_code.c[name])).label(name) for name in _INVITED]
    codes = select(*_columns(one_time_code, "secret_sha256", *_INVITED), *about)
    codes = codes.where(is_own | (one_time_code.c.created_by_id == person_id))
    has_password = select(literal("password").label("method"), password.c.changed_at)
    has_totp = select(literal("second factor").label("method"), totp.c.created_at, totp.c.confirmed_at)
    addresses = select(*person_email.c).where(person_email.c.person_id == person_id)
    return [
        _of(DataSection.account, person, "id", person_id),
        _Source(DataSection.addresses, addresses, person_email.c.email_key),
        _of(DataSection.identities, identity, "person_id", person_id, "refresh_token"),
        _Source(DataSection.sign_in, has_password.where(password.c.person_id == person_id), password.c.person_id),
        _Source(DataSection.sign_in, has_totp.where(totp.c.person_id == person_id), totp.c.person_id),
        _of(DataSection.sessions, session, "person_id", person_id, "secret_sha256"),
        _of(DataSection.tokens, token, "person_id", person_id, "secret_sha256"),
        _of(DataSection.logins, login_request, "approved_by_id", person_id, "secret_sha256", "code_challenge"),
        _Source(DataSection.invitations, codes, one_time_code.c.id),
    ]


def _access(person_id: uuid.UUID) -> list[_Source]:
    groups = (
        select(access_group.c.id, access_group.c.kind, access_group.c.name, *_columns(membership, "group_id"))
        .join_from(membership, access_group)
        .where(membership.c.person_id == person_id)
    )
    rights = (
        select(*access_grant.c, access_group.c.kind.label("group_kind"), access_group.c.name.label("group_name"))
        .join_from(access_grant, access_group)
        .join(membership, membership.c.group_id == access_group.c.id)
        .where(membership.c.person_id == person_id)
    )
    return [
        _Source(DataSection.groups, groups, access_group.c.id),
        _Source(DataSection.rights, rights, access_grant.c.id),
        _of(DataSection.links, share, "created_by_id", person_id, "secret_sha256"),
        _of(DataSection.runners, runner, "person_id", person_id),
    ]


def _work(person_id: uuid.UUID) -> list[_Source]:
    def named(section: DataSection, table: Table, by: str, *names: str) -> _Source:
        columns = [table.c[name] for name in ("id", "created_at", *names)]
        kind = literal(table.name).label("kind")
        return _Source(section, select(kind, *columns).where(table.c[by] == person_id), table.c.id)

    return [
        named(DataSection.projects, project, "created_by_id", "name"),
        named(DataSection.missions, mission, "created_by_id", "project_id", "name"),
        named(DataSection.uploads, upload, "person_id", "mission_id", "path", "state", "size_bytes"),
        named(DataSection.files, file, "uploaded_by_id", "mission_id", "path", "origin", "deleted_at"),
        named(DataSection.checks, check_report, "created_by_id", "mission_id"),
        named(DataSection.checks, check_note, "created_by_id", "mission_id", "text"),
        named(DataSection.checks, check_acceptance, "created_by_id", "mission_id", "check_name", "because"),
        named(DataSection.mission_events, mission_event, "created_by_id", "mission_id", "name", "note"),
        named(DataSection.viewer_layouts, viewer_layout, "created_by_id", "project_id", "name", "panels", "is_shared"),
        named(DataSection.actions, action, "created_by_id", "project_id", "name"),
        named(DataSection.actions, action_version, "created_by_id", "action_id", "number"),
        named(DataSection.runs, run, "started_by_id", "mission_id", "state", "parameters"),
    ]


def _history(person_id: uuid.UUID) -> list[_Source]:
    """Return the events of a person, and those about their account, without the credentials and addresses of others."""
    is_own = audit_event.c.actor_id == person_id
    is_about = (audit_event.c.resource_type == "person") & (audit_event.c.resource_id == person_id)
    origin = [case((is_own, audit_event.c[name])).label(name) for name in _ORIGIN]
    events = select(*_columns(audit_event, *_ORIGIN), *origin).where(is_own | is_about)
    return [_Source(DataSection.audit_events, events, audit_event.c.id)]
