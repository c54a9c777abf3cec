"""Projects: creating, listing, changing and deleting them, and the metadata fields that they declare."""

import asyncio
import uuid
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from pydantic import JsonValue, ValidationError
from pydantic_core import ErrorDetails, SchemaError
from sqlalchemy import ARRAY, BigInteger, ColumnElement, Row, Select, func, insert, literal, select, type_coerce, update
from sqlalchemy.dialects.postgresql import array
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.access import Right
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, FieldsInvalid, InvalidRequest, NameTaken, NotFound
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.metadata import Metadata, MetadataField, MetadataFields
from kleinkram.contract.missions import MissionTemplate
from kleinkram.contract.names import name_key
from kleinkram.contract.problems import message_of
from kleinkram.contract.projects import Deleted, ProjectCreate, ProjectRead, ProjectSort, ProjectUpdate
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import (
    check_credential,
    grant_first_rights,
    require_creator,
    require_match,
    require_project,
)
from kleinkram.server.access.visible import level_on_project, sees_whole_missions, visible_projects
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, by_name, violated_constraint
from kleinkram.server.filters.missions import filter_projects
from kleinkram.server.missions import service as missions
from kleinkram.server.missions.metadata import InvalidValue, MetadataValidator
from kleinkram.server.missions.queries import file_totals, total_duration
from kleinkram.server.pagination import Order, PageRequest, fetch_page
from kleinkram.server.settings import Creators
from kleinkram.server.tables import mission, person, project, upload
from kleinkram.server.tables.blobs import UNDER_WAY
from kleinkram.untrusted_yaml import Document, Path, read_yaml

# Only owners change the first two, and only admins the last.
_PUBLICATION = {"is_public", "licence", "citation"}
_ISOLATION = {"isolation"}
_QUOTA = {"quota_bytes", "quota_files"}


async def get_project(db: Connection, actor: Actor, project_id: uuid.UUID) -> ProjectRead:
    """Return one project. Raises NotFound."""
    stmt = _with_contents(actor, visible_projects(actor).where(project.c.id == project_id))
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(resource_type="project", ref=str(project_id))
    return _to_projects([row])[0]


async def list_projects(
    db: Connection, actor: Actor, *, name: str | None, text: str | None, sort: ProjectSort, page: PageRequest
) -> Page[ProjectRead]:
    """Return a page of the projects that match. Raises InvalidCursor."""
    stmt = _with_contents(actor, filter_projects(actor, visible_projects(actor), name=name, text=text))
    rows = await fetch_page(db, stmt, _order(sort), page)
    return Page(items=_to_projects(rows.items), next=rows.next, total=rows.total)


async def create_project(db: Connection, actor: Actor, *, request: ProjectCreate, creators: Creators) -> ProjectRead:
    """Create a project and return it. Raises Forbidden, YamlInvalid, FieldsInvalid or NameTaken."""
    needs_admin = await require_creator(db, actor, creators, resource_type="project")
    fields = await _read_declaration(request) or MetadataFields()
    project_id = uuid.uuid4()
    values: Metadata = {
        "name": request.name,
        "description": request.description,
        "metadata_fields": fields.model_dump(mode="json", exclude_none=True),
    }
    row = {**values, "id": project_id, "name_key": name_key(request.name), "created_by_id": actor.person_id}
    try:
        await db.execute(insert(project).values(**row))
    except IntegrityError as error:
        raise _name_taken(error, request.name) from error
    if grants := await grant_first_rights(db, actor, project_id):
        values["grants"] = {name: right.value for name, right in grants.items()}
    created = Event("project.create", "project", project_id, request.name, project_id, after=values)
    await audit(db, actor, replace(created, needs_admin=needs_admin))
    return await get_project(db, actor, project_id)


async def update_project(
    db: Connection,
    actor: Actor,
    *,
    project_id: uuid.UUID,
    changes: ProjectUpdate,
    weakest: Isolation,
    if_match: str | None = None,
) -> ProjectRead:
    """Change the given fields and return the project; missions that violate new metadata fields are only reported.

    Only owners publish a project and set its isolation, at least `weakest` (of the settings), and only admins set
    quotas. A quota below the current usage refuses new files. Another isolation counts for the runs that start from
    now on, also for queued ones.

    Raises NotFound, Forbidden, ScopeMissing, InvalidRequest, YamlInvalid, FieldsInvalid, NameTaken or EditConflict.
    """
    fields = await _read_declaration(changes)
    await db.execute(_lock_project(actor, project_id))
    await require_project(db, actor, "update_project", project_id)
    old = await get_project(db, actor, project_id)
    before, after = _changed_values(old, changes, fields)
    if not after:
        return old
    require_match(if_match, old.etag, resource_type="project", name=old.name)
    if after.keys() & _PUBLICATION:
        check_credential(actor, "publish_project")
        await require_project(db, actor, "publish_project", project_id)
    if after.keys() & _ISOLATION:
        check_credential(actor, "set_project_isolation")
        await require_project(db, actor, "set_project_isolation", project_id)
        _require_isolation(Isolation(after["isolation"]), weakest)
    if after.keys() & _QUOTA:
        check_credential(actor, "set_project_quota")
    values = after | ({"name_key": name_key(after["name"])} if "name" in after else {})
    try:
        await db.execute(update(project).where(project.c.id == project_id).values(**values))
    except IntegrityError as error:
        raise _name_taken(error, changes.name or old.name) from error
    if fields is not None and "metadata_fields" in after:
        await missions.revalidate_missions(db, project_id, fields)
    new = await get_project(db, actor, project_id)
    await audit(db, actor, *_events(new, before, after))
    return new


async def delete_project(db: Connection, actor: Actor, *, project_id: uuid.UUID, dry_run: bool) -> Deleted:
    """Move a project to the trash, or with `dry_run` return what would be moved; its name becomes free at once.

    Only the project is marked: its contents disappear and come back with it. Raises NotFound or Forbidden.
    """
    if not dry_run:
        await db.execute(_lock_project(actor, project_id))
    await require_project(db, actor, "delete_project", project_id)
    old = await get_project(db, actor, project_id)
    if not dry_run:
        marked = update(project).where(project.c.id == project_id)
        await db.execute(marked.values(deleted_at=func.now(), deleted_by_id=actor.person_id))
        before: Metadata = {"name": old.name}
        await audit(db, actor, Event("project.delete", "project", project_id, old.name, project_id, before))
    return Deleted(missions=old.mission_count, files=old.file_count, size_bytes=old.size_bytes, dry_run=dry_run)


async def get_template(db: Connection, actor: Actor, project_id: uuid.UUID) -> MissionTemplate:
    """Return the form for the next mission, filled in with the values of the last one. Raises NotFound."""
    return await missions.template_for(db, actor, project_id=project_id)


async def _read_declaration(request: ProjectCreate | ProjectUpdate) -> MetadataFields | None:
    if request.metadata_fields is not None:
        return await asyncio.to_thread(usable_fields, request.metadata_fields)
    return None if request.fields_yaml is None else await asyncio.to_thread(read_fields, request.fields_yaml)


def _changed_values(
    old: ProjectRead, changes: ProjectUpdate, fields: MetadataFields | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the old and new values, as stored, of what changes."""
    current = old.model_dump(mode="json", include={"name", "description", *_PUBLICATION, *_ISOLATION, *_QUOTA})
    current["metadata_fields"] = old.metadata_fields.model_dump(mode="json", exclude_none=True)
    others = {"fields_yaml", "metadata_fields", *_QUOTA}
    new: dict[str, Any] = changes.model_dump(mode="json", exclude=others, exclude_none=True)
    new |= changes.model_dump(include=_QUOTA, exclude_unset=True)  # null removes a quota
    if fields is not None:
        new["metadata_fields"] = fields.model_dump(mode="json", exclude_none=True)
    after = {name: value for name, value in new.items() if value != current[name]}
    return {name: current[name] for name in after}, after


def _require_isolation(isolation: Isolation, weakest: Isolation) -> None:
    """Check that the server allows an isolation. Raises InvalidRequest."""
    if not isolation.is_at_least(weakest):
        message = (
            f"this server allows {weakest.value} at least; an admin can change that with the setting "
            "KLEINKRAM_WEAKEST_ISOLATION"
        )
        raise InvalidRequest(problems=[FieldProblem(field="isolation", message=message)])


def _events(new: ProjectRead, before: Metadata, after: Metadata) -> list[Event]:
    """Return an audit event for each permission that a change required."""
    publication = "project.update"
    if "is_public" in after:
        publication = "project.publish" if new.is_public else "project.unpublish"
    groups = (
        ("project.update", "update_project", after.keys() - _PUBLICATION - _ISOLATION - _QUOTA),
        (publication, "publish_project", after.keys() & _PUBLICATION),
        ("project.set_isolation", "set_project_isolation", after.keys() & _ISOLATION),
        ("project.set_quota", "set_project_quota", after.keys() & _QUOTA),
    )
    return [
        Event(
            operation,
            "project",
            new.id,
            new.name,
            new.id,
            before={name: before[name] for name in before if name in names},
            after={name: after[name] for name in after if name in names},
            takes=takes,
        )
        for operation, takes, names in groups
        if names
    ]


def _name_taken(error: IntegrityError, name: str) -> Exception:
    return (
        NameTaken(resource_type="project", name=name)
        if violated_constraint(error) == "uq_project_name_key_live"
        else error
    )


def read_fields(text: str | None) -> MetadataFields:
    """Return the metadata fields that a `fields.yaml` declares; none for an empty text. Finds all problems.

    Raises YamlInvalid or FieldsInvalid.
    """
    document = read_yaml(text or "")
    if document.value is None:
        return MetadataFields()
    if not isinstance(document.value, dict):
        message = "must say 'fields:' and below it the list of fields, one '- {name: ..., type: ...}' each"
        raise FieldsInvalid(problems=[FieldProblem(field="fields.yaml", message=message)])
    try:
        fields = MetadataFields.model_validate(document.value)
    except ValidationError as error:
        problems = [
            _problem_at(document, tuple(issue["loc"]), message_of(issue))
            for issue in _merge_default_issues(error.errors())
            if issue["loc"]
        ]
        raise FieldsInvalid(problems=[*problems, *_find_duplicates(document)]) from None
    if problems := [_problem_at(document, path, message) for path, message in _unusable(fields)]:
        raise FieldsInvalid(problems=problems)
    return fields


def usable_fields(fields: MetadataFields) -> MetadataFields:
    """Return fields from a form if missions can be judged by them; names all problems. Raises FieldsInvalid."""
    if unusable := _unusable(fields):
        problems = [FieldProblem(field=".".join(map(str, path)), message=message) for path, message in unusable]
        raise FieldsInvalid(problems=problems)
    return fields


def _merge_default_issues(issues: Sequence[ErrorDetails]) -> list[ErrorDetails]:
    # A default can have many types; that it has none of them is one problem, not one for each.
    first: dict[Path, ErrorDetails] = {}
    for issue in issues:
        path = issue["loc"]
        if path[2:3] == ("default",):
            issue = {**issue, "loc": path[:3], "msg": "must be a text, a number, true, false, a date or a location"}
        first.setdefault(issue["loc"], issue)
    return list(first.values())


def _find_duplicates(document: Document) -> list[FieldProblem]:
    fields = document.value.get("fields") if isinstance(document.value, dict) else None
    seen: set[str] = set()
    problems = []
    for index, field in enumerate(fields if isinstance(fields, list) else []):
        name = field.get("name") if isinstance(field, dict) else None
        if isinstance(name, str):
            if name.casefold() in seen:
                problems.append(_problem_at(document, ("fields", index, "name"), "is declared twice"))
            seen.add(name.casefold())
    return problems


def _problem_at(document: Document, path: Path, message: str) -> FieldProblem:
    position = document.position(path)
    where = {"line": position.line, "column": position.column} if position else {}
    return FieldProblem(field=_format_path(document.value, path), message=message, **where)


def _format_path(value: JsonValue, path: Path) -> str:
    """Return a path with the names of fields, if they have one, instead of their numbers."""
    if len(path) > 1 and path[0] == "fields" and isinstance(path[1], int) and isinstance(value, dict):
        fields = value.get("fields")
        field = fields[path[1]] if isinstance(fields, list) else None
        name = field.get("name") if isinstance(field, dict) else None
        return ".".join([str(name or f"fields.{path[1]}"), *(str(part) for part in path[2:])])
    return ".".join(str(part) for part in path) or "fields.yaml"


def _unusable(fields: MetadataFields) -> list[tuple[Path, str]]:
    """Return the patterns and defaults that cannot be used, with the reason."""
    problems = enumerate(_find_problem(field) for field in fields.fields)
    return [(("fields", index, problem[0]), problem[1]) for index, problem in problems if problem is not None]


def _find_problem(field: MetadataField) -> tuple[str, str] | None:
    try:
        judge = MetadataValidator(MetadataFields(fields=[field]))
    except SchemaError as error:
        reason = str(error).strip().splitlines()[-1].split("rror: ")[-1]
        return "pattern", f"is not a regular expression: {reason}"
    try:
        judge.accept_default(field)
    except InvalidValue as wrong:
        return "default", str(wrong)
    return None


def _with_contents(actor: Actor, stmt: Select[Any]) -> Select[Any]:
    """Add the columns for `_to_projects` to a select that began with `visible_projects`."""
    sees_all = sees_whole_missions(actor)
    # Quotas and unfinished uploads of others are not shown to actors without an account.
    sees_uploads = sees_all and actor.person_id is not None
    unsatisfied: ColumnElement[int] = literal(0)
    if sees_all:
        unsatisfied = func.count().filter(func.jsonb_array_length(mission.c.metadata_problems) > 0)
    files, size_bytes = file_totals(actor)
    contents = _sums(func.count(), unsatisfied, func.sum(files), func.sum(size_bytes), func.sum(total_duration(actor)))
    uploads = _sums(func.count(), func.sum(upload.c.size_bytes)).where(
        upload.c.state.in_(UNDER_WAY), upload.c.run_id.is_(None)
    )
    if not sees_uploads:
        uploads = uploads.where(upload.c.person_id == actor.person_id)
    uploads = uploads.join_from(mission, upload, upload.c.mission_id == mission.c.id)
    return stmt.add_columns(
        person.c.name.label("created_by_name"),
        literal(sees_all).label("sees_all"),
        literal(sees_uploads).label("sees_uploads"),
        level_on_project(actor).label("level"),
        contents.select_from(mission).scalar_subquery().label("contents"),
        uploads.scalar_subquery().label("uploads"),
    ).join(person, person.c.id == project.c.created_by_id)


def _sums(*numbers: ColumnElement[Any]) -> Select[Any]:
    # Several numbers from one pass over the rows.
    return (
        select(type_coerce(array([func.coalesce(number, 0) for number in numbers]), ARRAY(BigInteger)))
        .where(mission.c.project_id == project.c.id, mission.c.deleted_at.is_(None))
        .correlate(project)
    )


def _to_projects(rows: Sequence[Row[Any]]) -> list[ProjectRead]:
    """Return the projects in rows of `_with_contents`."""
    return [_to_project(values) for values in by_name(rows)]


def _to_project(values: dict[str, Any]) -> ProjectRead:
    mission_count, unsatisfied, file_count, size_bytes, duration_ns = (int(number) for number in values["contents"])
    upload_count, upload_bytes = (int(number) for number in values["uploads"])
    if not values["sees_all"]:
        values["description"] = ""
    if not values["sees_uploads"]:
        values |= {"quota_bytes": None, "quota_files": None}
    values["created_by"] = {"id": values["created_by_id"], "name": values["created_by_name"]}
    values |= {"mission_count": mission_count, "unsatisfied_mission_count": unsatisfied, "file_count": file_count}
    values |= {"size_bytes": size_bytes, "duration_ns": duration_ns}
    values |= {"used_bytes": size_bytes + upload_bytes, "used_files": file_count + upload_count}
    values["right"] = Right.of_level(values["level"])
    return ProjectRead.model_validate(values)


def _lock_project(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return the select that locks a visible project, against changes and against missions created in it."""
    stmt = visible_projects(actor).with_only_columns(project.c.id).where(project.c.id == project_id)
    return stmt.with_for_update()


def _order(sort: ProjectSort) -> Order:
    """Return the order of a list of projects."""
    column = project.c.name if sort.value.endswith("name") else project.c.created_at
    return Order([column, project.c.id], sort.value.startswith("-"))
