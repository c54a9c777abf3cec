"""What may be done with missions. A mission comes to be only with metadata that satisfies its project.

The order of locks, everywhere: project, mission, upload, blob, file; rows of one table by id. Whoever changes what a
mission holds begins with `lock_mission`, and only then reads what the change depends on.
"""

import asyncio
import uuid
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Row, Update, func, insert
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
    MissionTemplate,
    MissionUpdate,
)
from kleinkram.contract.names import name_key
from kleinkram.contract.projects import Deleted
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission, require_project
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.filters.plan import ID_COUNT, NO_PLAN, SearchPlan, rounded
from kleinkram.server.filters.prepared import prepare
from kleinkram.server.http.headers import require_match
from kleinkram.server.missions import queries
from kleinkram.server.missions.amounts import NOTHING
from kleinkram.server.missions.metadata import (
    MetadataValidator,
    carried_over,
    defaults,
    read_metadata,
    satisfying,
    write_template,
)
from kleinkram.server.pagination import PageRequest, fetch_listing
from kleinkram.server.quotas import require_room_for_mission
from kleinkram.server.tables import mission
from kleinkram.server.yaml_text import Document

_JUDGED_AT_ONCE = 500
SAMPLED_MISSIONS = 100
# Of more, the files are so many that each mission's own are no shorter way.
MAX_VISIBLE_IDS = 32


async def lock_mission(db: Connection, mission_id: uuid.UUID) -> bool:
    """Do as `lock_missions` for one, and say whether there is such a mission."""
    return mission_id in await lock_missions(db, [mission_id])


async def lock_missions(db: Connection, mission_ids: Collection[uuid.UUID]) -> set[uuid.UUID]:
    """Hold others off changing missions, their uploads and files, until this transaction ends; return those there are.

    Their projects are kept from being deleted, restored or dropped meanwhile. Says nothing of who may see them, nor
    whether they are in the trash: that is read afterwards, by a statement of its own, and then stays true.
    """
    await db.execute(queries.lock_projects_of(mission_ids))
    return set((await db.execute(queries.lock_missions(mission_ids))).scalars())


async def lock_mission_to_fill(db: Connection, actor: Actor, mission_id: uuid.UUID) -> None:
    """Do as `lock_mission`, and see that `actor` may put files into it: it stays until this transaction ends.

    Raises:
        NotFound: no such mission for `actor`.
        Forbidden: they may see it, but put nothing into it.
    """
    await lock_mission(db, mission_id)
    await require_mission(db, actor, "begin_uploads", mission_id)


async def get_mission_row(db: Connection, actor: Actor, mission_id: uuid.UUID) -> Row[Any]:
    """Return the row of a mission, with `project_name`.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = (await db.execute(queries.mission_by_id(actor, mission_id))).one_or_none()
    if row is None:
        raise NotFound(noun="mission", ref=str(mission_id))
    return row


async def get_mission(db: Connection, actor: Actor, mission_id: uuid.UUID) -> MissionRead:
    """Return one mission and what it amounts to.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = (await db.execute(queries.whole_mission(actor, mission_id))).one_or_none()
    if row is None:
        raise NotFound(noun="mission", ref=str(mission_id))
    return queries.to_missions([row])[0]


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
    """Return a page of the missions that match, among those that a query finds, by themselves or by their files.

    Raises:
        InvalidQuery: a `where` cannot be used.
        InvalidCursor: the cursor is not of this list.
    """
    filters = [matching] if by_files is None else [matching, by_files]
    listing, values = prepare(queries.mission_listing, actor, *filters, plan=plan, sort=sort)
    rows = await fetch_listing(db, listing, page, values)
    return Page(items=queries.to_missions(rows.items), next=rows.next, total=rows.total)


async def find_visible_mission_ids(db: Connection, actor: Actor) -> Sequence[uuid.UUID] | None:
    """Return all missions that an actor sees, where there are at most `MAX_VISIBLE_IDS`; None where there are more.

    PostgreSQL expects everybody to see most missions. Whoever sees few of two million files would otherwise wait for
    seconds, until an index of all files in order has been read past everybody else's. It grants nothing: every
    statement still checks the rights.
    """
    if actor.is_admin:
        return None
    mission_ids = (await db.execute(*prepare(queries.visible_ids, actor, limit=MAX_VISIBLE_IDS + 1))).scalars().all()
    return None if len(mission_ids) > MAX_VISIBLE_IDS else mission_ids


async def estimate_matching(db: Connection, actor: Actor, by_files: FileFilter, plan: SearchPlan) -> int | None:
    """Estimate from a sample how many missions a filter of files finds; exact where the sample holds all missions.

    None where no sampled mission matches, and others may.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    statement = prepare(queries.sampled_missions, actor, by_files, plan=plan, size=SAMPLED_MISSIONS)
    row = (await db.execute(*statement)).one()
    if row.sampled < SAMPLED_MISSIONS:
        return int(row.hits)
    return rounded(row.hits * ID_COUNT // max(row.last_id.int, 1)) or None


async def create_mission(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, new_mission: MissionCreate
) -> MissionRead:
    """Make a mission and return it.

    Raises:
        NotFound: the project is not there, or not for this actor.
        Forbidden: they may see it, but make nothing in it.
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
        **NOTHING,
    )
    try:
        await db.execute(statement)
    except IntegrityError as error:
        raise _name_taken(error, new_mission.name) from error
    made = await get_mission(db, actor, mission_id)
    after: Metadata = {"name": made.name, "metadata": metadata}
    event = Event("mission.create", "mission", mission_id, made.name, project_id, after=after, mission_id=mission_id)
    await audit(db, actor, event)
    return made


async def update_mission(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, changes: MissionUpdate, if_match: str | None = None
) -> MissionRead:
    """Change what is given and return the mission; where it is all so already, nothing is asked of its ETag.

    A mission that moves keeps its metadata; what of it does not satisfy the new project is reported, not refused.

    Raises:
        NotFound: the mission, or the project to move it to, is not there.
        Forbidden: the change takes more than they hold here, or, for a move, there.
        YamlInvalid: the metadata cannot be read.
        MetadataInvalid: new metadata does not satisfy the project.
        NameTaken: the project has a mission of that name.
        QuotaExceeded: the project to move it to has no room for it.
        EditConflict: it is not of the ETag in `if_match` any more.
    """
    has_metadata = changes.metadata_yaml is not None or changes.metadata is not None
    document = await _read_document(changes) if has_metadata else None
    row = await get_mission_row(db, actor, mission_id)
    # Before anything is said of the project to move it to; and once more when it is held.
    moves = changes.project_id is not None and changes.project_id != row.project_id
    await require_mission(db, actor, "move_mission" if moves else "update_mission", mission_id)
    if document is not None or changes.project_id is not None:
        # Project before mission, as where a project's fields change, so that the two never wait for each other.
        await _fields_after(db, actor, row.id, moves_to=changes.project_id if moves else None)
    await lock_mission(db, mission_id)
    old = await get_mission(db, actor, mission_id)
    await _see_that_it_may_change(db, actor, old, changes)
    if changes.project_id is not None and changes.project_id != old.project.id:
        await require_room_for_mission(db, actor, project_id=changes.project_id, mission_id=mission_id)
    values = _simple_changes(old, changes) | await _judged_changes(db, actor, old, changes=changes, document=document)
    if not values:
        return old
    require_match(if_match, old.etag, noun="mission", name=old.name)
    await _change(db, queries.change_mission(mission_id, **values), name=changes.name or old.name)
    new = await get_mission(db, actor, mission_id)
    differing = [name for name in _AUDITED if _audited_value(old, name) != _audited_value(new, name)]
    before, after = ({name: _audited_value(version, name) for name in differing} for version in (old, new))
    await audit(db, actor, *_moved(old, new, before, after) if "project" in after else _updated(new, before, after))
    return new


async def delete_mission(db: Connection, actor: Actor, *, mission_id: uuid.UUID, dry_run: bool) -> Deleted:
    """Move a mission and its files to the trash; its name is free at once. As a dry run, only say what would go.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they may see it, but not delete it.
    """
    if not dry_run:
        await lock_mission(db, mission_id)
    row = await get_mission_row(db, actor, mission_id)
    await require_mission(db, actor, "delete_mission", mission_id)
    files, size_bytes = (await db.execute(queries.contents(actor, mission_id))).one()
    if not dry_run:
        await db.execute(queries.change_mission(mission_id, deleted_at=func.now(), deleted_by_id=actor.person_id))
        before: Metadata = {"name": row.name, "project": row.project_name}
        event = Event("mission.delete", "mission", mission_id, row.name, row.project_id, before, mission_id=mission_id)
        await audit(db, actor, event)
    return Deleted(missions=1, files=files, size_bytes=int(size_bytes), dry_run=dry_run)


async def rejudge_missions(db: Connection, project_id: uuid.UUID, fields: MetadataFields) -> None:
    """Note for every mission of a project what no longer satisfies its fields; nothing else of them changes.

    Holds some hundred missions in memory at a time.
    """
    judge = MetadataValidator(fields)
    after: uuid.UUID | None = None
    while True:
        statement = queries.metadata_of_project(project_id, after=after, limit=_JUDGED_AT_ONCE)
        rows = (await db.execute(statement)).all()
        judged = [(row, _problems(judge, row.metadata)) for row in rows]
        changed = [
            {"ref": row.id, "problems": problems} for row, problems in judged if problems != row.metadata_problems
        ]
        if changed:
            await db.execute(queries.set_problems(), changed)
        if len(rows) < _JUDGED_AT_ONCE:
            return
        after = rows[-1].id


async def template_for(db: Connection, actor: Actor, *, project_id: uuid.UUID) -> MissionTemplate:
    """Return what to fill in for a project's next mission, and the mission whose values are suggested.

    Raises:
        NotFound: the project is not there, or not for this actor.
    """
    name, fields = await _project(db, actor, project_id)
    last: Row[Any] | None = None
    if sees_whole_missions(actor):
        last = (await db.execute(queries.last_mission(actor, project_id))).one_or_none()
    values = defaults(fields)
    carried = carried_over(fields, last.metadata) if last else {}
    return MissionTemplate(
        yaml=write_template(fields, values, carried, project=name, source=last.name if last else None),
        fields=fields,
        values=values,
        carried=carried,
        prefilled_from=queries.to_mission_ref(last) if last else None,
    )


async def _read_document(request: MissionCreate | MissionUpdate) -> Document:
    if request.metadata is not None:
        return Document(request.metadata)
    return await asyncio.to_thread(read_metadata, request.metadata_yaml)


async def _see_that_it_may_change(db: Connection, actor: Actor, old: MissionRead, changes: MissionUpdate) -> None:
    if changes.project_id is not None and changes.project_id != old.project.id:
        await require_mission(db, actor, "move_mission", old.id)
        await require_project(db, actor, "create_mission", changes.project_id)
    else:
        await require_mission(db, actor, "update_mission", old.id)


def _updated(new: MissionRead, before: Metadata, after: Metadata) -> list[Event]:
    return [Event("mission.update", "mission", new.id, new.name, new.project.id, before, after, mission_id=new.id)]


def _moved(old: MissionRead, new: MissionRead, before: Metadata, after: Metadata) -> list[Event]:
    """Return what the record of each of two projects says of a move; neither names the other to its owners."""
    left: Metadata = {"name": old.name}
    before = {name: value for name, value in before.items() if name != "project"}
    came = Event("mission.arrive", "mission", new.id, new.name, new.project.id, before, after, new.id, "create_mission")
    return [
        Event("mission.leave", "mission", old.id, old.name, old.project.id, left, {}, None, "move_mission"),
        came,
    ]


_AUDITED = ("name", "project", "metadata", "notes", "completed_at")


def _audited_value(seen: MissionRead, name: str) -> Any:  # Any: whatever JSON the record keeps of an attribute
    return seen.project.name if name == "project" else seen.model_dump(mode="json", include={name})[name]


def _problems(judge: MetadataValidator, metadata: dict[str, Any]) -> list[dict[str, Any]]:
    return [problem.model_dump(exclude_none=True) for problem in judge.judge(Document(metadata)).problems]


def _simple_changes(old: MissionRead, changes: MissionUpdate) -> dict[str, Any]:
    values: dict[str, Any] = {}
    if changes.name is not None and changes.name != old.name:
        values |= {"name": changes.name, "name_key": name_key(changes.name)}
    if changes.notes is not None and changes.notes != old.notes:
        values["notes"] = changes.notes
    if changes.completed is not None and changes.completed != (old.completed_at is not None):
        values["completed_at"] = func.now() if changes.completed else None
    return values


async def _judged_changes(
    db: Connection, actor: Actor, old: MissionRead, *, changes: MissionUpdate, document: Document | None
) -> dict[str, Any]:
    project_id = changes.project_id or old.project.id
    keeps_text = document is not None and changes.metadata is None and not changes.merge_yaml
    if document is not None and not keeps_text:
        changed = old.metadata | (document.value if isinstance(document.value, dict) else {})
        values: Metadata = {name: value for name, value in changed.items() if value is not None}
        document = replace(document, value=values)
    if document is None and project_id == old.project.id:
        return {}
    fields = await _fields_after(db, actor, old.id, moves_to=None if project_id == old.project.id else project_id)
    moved: dict[str, Any] = {} if project_id == old.project.id else {"project_id": project_id}
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
        raise NotFound(noun="project", ref=str(project_id))
    return row.name, MetadataFields.model_validate(row.metadata_fields)


async def _fields_after(
    db: Connection, actor: Actor, mission_id: uuid.UUID, *, moves_to: uuid.UUID | None
) -> MetadataFields:
    """Return the fields that a mission is held to after a change, kept from changing meanwhile."""
    if moves_to is not None:
        return (await _project(db, actor, moves_to))[1]
    row = (await db.execute(queries.fields_of_mission(mission_id))).one_or_none()
    if row is None:
        raise NotFound(noun="mission", ref=str(mission_id))
    return MetadataFields.model_validate(row.metadata_fields)


async def _change(db: Connection, statement: Update, *, name: str) -> None:
    try:
        await db.execute(statement)
    except IntegrityError as error:
        raise _name_taken(error, name) from error


def _name_taken(error: IntegrityError, name: str) -> Exception:
    return NameTaken(noun="mission", name=name) if violated_constraint(error) == "uq_mission_name_key_live" else error
