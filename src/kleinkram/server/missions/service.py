"""Operations on missions. A mission is created only with metadata that satisfies its project.

Locks are acquired in this order everywhere: project, mission, upload, blob, file; rows of one table by id. A change of
the content of a mission begins with `lock_mission`, and then reads what it depends on.
"""

import asyncio
import uuid
from collections.abc import Collection
from dataclasses import replace

from sqlalchemy import Insert, Update, func, insert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.base import Page
from kleinkram.contract.errors import NameTaken, NotFound
from kleinkram.contract.files import FileFilter
from kleinkram.contract.metadata import Metadata, MetadataFields
from kleinkram.contract.missions import (
    MissionCreate,
    MissionFilter,
    MissionOrder,
    MissionRead,
    MissionRef,
    MissionTemplate,
    MissionUpdate,
)
from kleinkram.contract.names import name_key
from kleinkram.contract.projects import Deleted
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_match, require_mission, require_project
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan, prepare_statement
from kleinkram.server.jobs.decide_runs import decide_again, decide_again_by_metadata
from kleinkram.server.jobs.rejudge import judge_again
from kleinkram.server.missions import queries
from kleinkram.server.missions.metadata import (
    MetadataValidator,
    carried_over,
    defaults,
    read_metadata,
    satisfying,
    write_template,
)
from kleinkram.server.pagination import PageRequest, read_listing
from kleinkram.server.quotas import require_room_for_mission
from kleinkram.server.tables import mission
from kleinkram.untrusted_yaml import Document

_VALIDATED_AT_ONCE = 500
# The verdict depends on these: rules apply by metadata, and are those of the project.
_JUDGED = frozenset({"metadata", "project_id", "completed_at"})


async def lock_mission(db: Connection, mission_id: uuid.UUID) -> bool:
    """Lock one mission as `lock_missions` does, and return whether it exists."""
    return mission_id in await lock_missions(db, [mission_id])


async def lock_missions(db: Connection, mission_ids: Collection[uuid.UUID]) -> set[uuid.UUID]:
    """Lock missions, their uploads and files against changes until this transaction ends; return those that exist.

    Their projects cannot be deleted, restored or purged in the meantime. Rights, and whether a mission is in the
    trash, must be read afterwards, by another statement.
    """
    await db.execute(queries.lock_projects_of(mission_ids))
    return set((await db.execute(queries.lock_missions(mission_ids))).scalars())


async def lock_mission_to_fill(db: Connection, actor: Actor, mission_id: uuid.UUID) -> None:
    """Lock a mission, and check that `actor` may add files to it. Raises NotFound or Forbidden."""
    await lock_mission(db, mission_id)
    await require_mission(db, actor, "begin_uploads", mission_id)


async def get_mission_ref(db: Connection, actor: Actor, mission_id: uuid.UUID) -> MissionRef:
    """Return the names of a mission and its project. Raises NotFound."""
    row = (await db.execute(queries.mission_ref_row(actor, mission_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="mission", ref=str(mission_id))
    return queries.mission_ref(*row)


async def get_mission(db: Connection, actor: Actor, mission_id: uuid.UUID) -> MissionRead:
    """Return one mission with its totals. Raises NotFound."""
    visible = (await get_missions(db, actor, [mission_id])).get(mission_id)
    if visible is None:
        raise NotFound(resource_type="mission", ref=str(mission_id))
    return visible


async def get_missions(
    db: Connection, actor: Actor, mission_ids: Collection[uuid.UUID]
) -> dict[uuid.UUID, MissionRead]:
    """Return those of some missions that are visible by their ids, with their totals."""
    rows = (await db.execute(queries.complete_missions(actor, mission_ids))).all()
    return {one.id: one for one in queries.to_missions(rows)}


async def list_missions(
    db: Connection,
    actor: Actor,
    *,
    matching: MissionFilter,
    by_files: FileFilter | None = None,
    sort: MissionOrder,
    page: PageRequest,
    plan: SearchPlan = NO_PLAN,
) -> Page[MissionRead]:
    """Return a page of the missions that match; with `by_files`, of those that it finds by their own fields or files.

    Raises:
        InvalidQuery: a `where` cannot be used.
        InvalidCursor: the cursor is not of this list.
    """
    filters = [matching] if by_files is None else [matching, by_files]
    listing, values = prepare_statement(queries.mission_listing, actor, *filters, plan=plan, sort=sort)
    return await read_listing(db, listing, page, values)


async def create_mission(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, new_mission: MissionCreate
) -> MissionRead:
    """Create a mission and return it.

    Raises:
        NotFound: the project does not exist, or is not visible.
        Forbidden: the actor may not create missions in it.
        YamlInvalid: the metadata cannot be read.
        MetadataInvalid: it does not satisfy the project; names every missing, wrong or unknown field.
        NameTaken: the project has a mission of that name.
    """
    document = await _read_document(new_mission)
    _, fields = await _project(db, actor, project_id)
    await require_project(db, actor, "create_mission", project_id)
    mission_id, metadata = uuid.uuid4(), satisfying(document, fields)
    statement = insert(mission).values(
        id=mission_id,
        project_id=project_id,
        name=new_mission.name,
        name_key=name_key(new_mission.name),
        metadata=metadata,
        metadata_yaml=new_mission.metadata_yaml,
        notes=new_mission.notes,
        created_by_id=actor.person_id,
        **queries.NO_TOTALS,
    )
    await _change(db, statement, name=new_mission.name)
    created = await get_mission(db, actor, mission_id)
    after: Metadata = {"name": created.name, "metadata": metadata}
    event = Event("mission.create", "mission", mission_id, created.name, project_id, after=after, mission_id=mission_id)
    await audit(db, actor, event)
    return created


async def update_mission(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, changes: MissionUpdate, if_match: str | None = None
) -> MissionRead:
    """Change a mission and return it; its ETag is not checked where nothing changes.

    A mission that moves keeps its metadata; problems of it in the new project are reported and not refused.

    Raises:
        NotFound: the mission, or the project to move it to, does not exist.
        Forbidden: the change requires a right that the actor lacks on the mission or the other project.
        YamlInvalid: the metadata cannot be read.
        MetadataInvalid: new metadata does not satisfy the project.
        NameTaken: the project has a mission of that name.
        QuotaExceeded: the project to move it to has no room for it.
        EditConflict: its ETag is not the one in `if_match`.
    """
    has_metadata = changes.metadata_yaml is not None or changes.metadata is not None
    document = await _read_document(changes) if has_metadata else None
    ref = await get_mission_ref(db, actor, mission_id)
    # Before anything about the other project is revealed; and again once the mission is locked.
    moves = changes.project_id is not None and changes.project_id != ref.project.id
    await require_mission(db, actor, "move_mission" if moves else "update_mission", mission_id)
    if document is not None or changes.project_id is not None:
        # Project before mission, as where the fields of a project change, so that the two cannot deadlock.
        await _fields_after(db, actor, mission_id, moves_to=changes.project_id if moves else None)
    await lock_mission(db, mission_id)
    old = await get_mission(db, actor, mission_id)
    if changes.project_id is not None and changes.project_id != old.project.id:
        await require_mission(db, actor, "move_mission", mission_id)
        await require_project(db, actor, "create_mission", changes.project_id)
        await require_room_for_mission(db, actor, project_id=changes.project_id, mission_id=mission_id)
    else:
        await require_mission(db, actor, "update_mission", mission_id)
    values = _plain_changes(old, changes) | await _metadata_changes(db, actor, old, changes=changes, document=document)
    if not values:
        return old
    require_match(if_match, old.etag, resource_type="mission", name=old.name)
    await _change(db, queries.change_mission(mission_id, **values), name=changes.name or old.name)
    if values.get("completed_at") is not None:
        await decide_again(db, mission_id)
    if values.keys() & _JUDGED:
        await judge_again(db, [mission_id])
    new = await get_mission(db, actor, mission_id)
    if changed := {name for name in old.metadata | new.metadata if old.metadata.get(name) != new.metadata.get(name)}:
        await decide_again_by_metadata(db, mission_id, changed, by_run_id=actor.run_id)
    await audit(db, actor, *_change_events(old, new))
    return new


async def delete_mission(db: Connection, actor: Actor, *, mission_id: uuid.UUID, dry_run: bool) -> Deleted:
    """Move a mission and its files to the trash; its name is free at once. With `dry_run`, only report what would go.

    Raises:
        NotFound: it does not exist, or is not visible.
        Forbidden: the actor may not delete it.
    """
    if not dry_run:
        await lock_mission(db, mission_id)
    old = await get_mission_ref(db, actor, mission_id)
    await require_mission(db, actor, "delete_mission", mission_id)
    files, size_bytes = (await db.execute(queries.contents(actor, mission_id))).one()
    if not dry_run:
        await db.execute(queries.change_mission(mission_id, deleted_at=func.now(), deleted_by_id=actor.person_id))
        before: Metadata = {"name": old.name, "project": old.project.name}
        event = Event("mission.delete", "mission", mission_id, old.name, old.project.id, before, mission_id=mission_id)
        await audit(db, actor, event)
    return Deleted(missions=1, files=files, size_bytes=int(size_bytes), dry_run=dry_run)


async def revalidate_missions(db: Connection, project_id: uuid.UUID, fields: MetadataFields) -> None:
    """Store for every mission of a project the problems of its metadata with new fields; nothing else of them changes.

    Holds some hundred missions in memory at a time.
    """
    validator = MetadataValidator(fields)
    after: uuid.UUID | None = None
    while True:
        statement = queries.metadata_of_project(project_id, after=after, limit=_VALIDATED_AT_ONCE)
        rows = (await db.execute(statement)).all()
        validated = [(row, _problems(validator, row.metadata)) for row in rows]
        changed = [
            {"ref": row.id, "problems": problems} for row, problems in validated if problems != row.metadata_problems
        ]
        if changed:
            await db.execute(queries.set_problems(), changed)
        if len(rows) < _VALIDATED_AT_ONCE:
            return
        after = rows[-1].id


async def template_for(db: Connection, actor: Actor, *, project_id: uuid.UUID) -> MissionTemplate:
    """Return a template for a new mission's metadata, and the mission whose values it suggests. Raises NotFound."""
    name, fields = await _project(db, actor, project_id)
    previous: MissionRef | None = None
    values, carried = defaults(fields), {}
    if sees_whole_missions(actor) and (
        row := (await db.execute(queries.last_mission(actor, project_id))).one_or_none()
    ):
        *ref, metadata = row
        previous, carried = queries.mission_ref(*ref), carried_over(fields, metadata)
    return MissionTemplate(
        yaml=write_template(fields, values, carried, project=name, source=previous.name if previous else None),
        fields=fields,
        values=values,
        carried=carried,
        prefilled_from=previous,
    )


async def _read_document(request: MissionCreate | MissionUpdate) -> Document:
    if request.metadata is not None:
        return Document(request.metadata)
    return await asyncio.to_thread(read_metadata, request.metadata_yaml)


_AUDITED = ("name", "project", "metadata", "notes", "completed_at")


def _change_events(old: MissionRead, new: MissionRead) -> list[Event]:
    """Return the audit events of a change. After a move, neither project's event names the other project."""
    versions: list[Metadata] = [
        version.model_dump(mode="json", include={*_AUDITED}) | {"project": version.project.name}
        for version in (old, new)
    ]
    differing = [name for name in _AUDITED if versions[0][name] != versions[1][name]]
    before, after = ({name: version[name] for name in differing} for version in versions)
    project_id = new.project.id
    if "project" not in after:
        return [Event("mission.update", "mission", new.id, new.name, project_id, before, after, mission_id=new.id)]
    before.pop("project")
    left: Metadata = {"name": old.name}
    return [
        Event("mission.move_out", "mission", old.id, old.name, old.project.id, left, {}, None, "move_mission"),
        Event("mission.move_in", "mission", new.id, new.name, project_id, before, after, new.id, "create_mission"),
    ]


def _problems(validator: MetadataValidator, metadata: Metadata) -> list[Metadata]:
    return [problem.model_dump(exclude_none=True) for problem in validator.validate(Document(metadata)).problems]


def _plain_changes(old: MissionRead, changes: MissionUpdate) -> dict[str, object]:
    values: dict[str, object] = {}
    if changes.name is not None and changes.name != old.name:
        values |= {"name": changes.name, "name_key": name_key(changes.name)}
    if changes.notes is not None and changes.notes != old.notes:
        values["notes"] = changes.notes
    if changes.completed is not None and changes.completed != (old.completed_at is not None):
        values["completed_at"] = func.now() if changes.completed else None
    return values


async def _metadata_changes(
    db: Connection, actor: Actor, old: MissionRead, *, changes: MissionUpdate, document: Document | None
) -> dict[str, object]:
    project_id = changes.project_id or old.project.id
    keeps_text = document is not None and changes.metadata is None and not changes.merge_yaml
    if document is not None and not keeps_text:
        changed = old.metadata | (document.value if isinstance(document.value, dict) else {})
        values: Metadata = {name: value for name, value in changed.items() if value is not None}
        document = replace(document, value=values)
    if document is None and project_id == old.project.id:
        return {}
    fields = await _fields_after(db, actor, old.id, moves_to=None if project_id == old.project.id else project_id)
    moved: dict[str, object] = {} if project_id == old.project.id else {"project_id": project_id}
    if document is None:
        return moved | {"metadata_problems": _problems(MetadataValidator(fields), old.metadata)}
    metadata = satisfying(document, fields)
    text = changes.metadata_yaml if keeps_text else None
    same_document = not keeps_text or old.metadata_yaml == text
    if not moved and same_document and (old.metadata, old.metadata_problems) == (metadata, []):
        return {}
    return moved | {"metadata": metadata, "metadata_yaml": text, "metadata_problems": []}


async def _project(db: Connection, actor: Actor, project_id: uuid.UUID) -> tuple[str, MetadataFields]:
    row = (await db.execute(queries.fields_of_project(actor, project_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="project", ref=str(project_id))
    return row.name, MetadataFields.model_validate(row.metadata_fields)


async def _fields_after(
    db: Connection, actor: Actor, mission_id: uuid.UUID, *, moves_to: uuid.UUID | None
) -> MetadataFields:
    """Return the fields that apply to a mission after a change, locked until the transaction ends."""
    if moves_to is not None:
        return (await _project(db, actor, moves_to))[1]
    row = (await db.execute(queries.fields_of_mission(mission_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="mission", ref=str(mission_id))
    return MetadataFields.model_validate(row.metadata_fields)


async def _change(db: Connection, statement: Insert | Update, *, name: str) -> None:
    try:
        await db.execute(statement)
    except IntegrityError as error:
        if violated_constraint(error) == "uq_mission_name_key_live":
            raise NameTaken(resource_type="mission", name=name) from error
        raise
