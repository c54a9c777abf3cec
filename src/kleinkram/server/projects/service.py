"""What may be done with projects."""

import asyncio
import uuid
from collections.abc import Mapping
from typing import Any

from sqlalchemy import func, insert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.errors import NameTaken, NotFound
from kleinkram.contract.metadata import Metadata, MetadataFields
from kleinkram.contract.missions import MissionTemplate
from kleinkram.contract.names import name_key
from kleinkram.contract.paging import Page
from kleinkram.contract.projects import ProjectCreate, ProjectRead, ProjectSort, ProjectUpdate
from kleinkram.contract.trash import Deleted
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.creation import grant_first_rights, require_creator
from kleinkram.server.access.rights import admit, require_project
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.http.etags import require_match
from kleinkram.server.missions import service as missions
from kleinkram.server.paging import PageRequest, fetch_page
from kleinkram.server.projects import queries
from kleinkram.server.projects.fields import read_fields, usable_fields
from kleinkram.server.settings import Creators
from kleinkram.server.tables import project

# What of a project is for its owners, and what for admins.
_OF_RELEASE = {"is_public", "licence", "citation"}
_OF_QUOTA = {"quota_bytes", "quota_files"}


async def get_project(db: Connection, actor: Actor, project_id: uuid.UUID) -> ProjectRead:
    """Return one project and what it amounts to.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = (await db.execute(queries.project_by_id(actor, project_id))).one_or_none()
    if row is None:
        raise NotFound(noun="project", ref=str(project_id))
    return queries.to_projects([row])[0]


async def list_projects(
    db: Connection, actor: Actor, *, name: str | None, text: str | None, sort: ProjectSort, page: PageRequest
) -> Page[ProjectRead]:
    """Return a page of the projects that match.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    matched = queries.matching_projects(actor, name=name, text=text)
    rows = await fetch_page(db, matched, queries.project_order(sort), page)
    return Page(items=queries.to_projects(rows.items), next=rows.next, total=rows.total)


async def create_project(db: Connection, actor: Actor, *, wanted: ProjectCreate, creators: Creators) -> ProjectRead:
    """Make a project and return it.

    Raises:
        Forbidden: the settings let others make projects.
        YamlInvalid: the field definitions cannot be read.
        FieldsInvalid: they are not usable; names every problem.
        NameTaken: there is a project of that name.
    """
    by_power = await require_creator(db, actor, creators, noun="project")
    fields = await _declared(wanted) or MetadataFields()
    project_id = uuid.uuid4()
    values = {"name": wanted.name, "name_key": name_key(wanted.name), "metadata_fields": _stored(fields)}
    statement = insert(project).values(
        id=project_id, description=wanted.description, created_by_id=actor.person_id, **values
    )
    try:
        await db.execute(statement)
    except IntegrityError as error:
        raise _name_taken(error, wanted.name) from error
    after = {"name": wanted.name, "description": wanted.description, "metadata_fields": values["metadata_fields"]}
    given = await grant_first_rights(db, actor, project_id)
    after |= {"grants": {name: right.value for name, right in given.items()}} if given else {}
    event = Event("project.create", "project", project_id, wanted.name, project_id, after=after, by_power=by_power)
    await record(db, actor, event)
    return await get_project(db, actor, project_id)


async def update_project(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, changes: ProjectUpdate, if_match: str | None = None
) -> ProjectRead:
    """Change what is given and return the project. Missions that no longer satisfy new fields are reported, not broken.

    To publish it, or take that back, is for its owners; its quotas are for admins. A quota below what is used keeps
    more from coming, and takes nothing away.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they may see it, but not change it, or not that of it.
        ScopeMissing: the token is not for that change.
        YamlInvalid: the field definitions cannot be read.
        FieldsInvalid: they are not usable; names every problem.
        NameTaken: there is a project of that name.
        EditConflict: it is not of the ETag in `if_match` any more, and what is asked for is not so already.
    """
    fields = await _declared(changes)
    await db.execute(queries.lock_project(actor, project_id))
    await require_project(db, actor, "update_project", project_id)
    old = await get_project(db, actor, project_id)
    before, after = _changes(old, changes, fields)
    if not after:
        return old
    require_match(if_match, old.etag, noun="project", name=old.name)
    await _see_that_it_may_change(db, actor, project_id, after)
    values = after | ({"name_key": name_key(after["name"])} if "name" in after else {})
    try:
        await db.execute(queries.change_project(project_id, **values))
    except IntegrityError as error:
        raise _name_taken(error, changes.name or old.name) from error
    if fields is not None and "metadata_fields" in after:
        await missions.rejudge_missions(db, project_id, fields)
    new = await get_project(db, actor, project_id)
    await record(db, actor, *_events(new, before, after))
    return new


async def delete_project(db: Connection, actor: Actor, *, project_id: uuid.UUID, dry_run: bool) -> Deleted:
    """Move a project and all in it to the trash; its name is free at once. As a dry run, only say what would go.

    Only the project itself is marked: what it holds is out of sight with it, and back with it.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they may see it, but not delete it.
    """
    if not dry_run:
        await db.execute(queries.lock_project(actor, project_id))
    await require_project(db, actor, "delete_project", project_id)
    seen = await get_project(db, actor, project_id)
    if not dry_run:
        await db.execute(queries.change_project(project_id, deleted_at=func.now(), deleted_by_id=actor.person_id))
        before: Metadata = {"name": seen.name}
        await record(db, actor, Event("project.delete", "project", project_id, seen.name, project_id, before))
    return Deleted(missions=seen.mission_count, files=seen.file_count, size_bytes=seen.size_bytes, dry_run=dry_run)


async def get_template(db: Connection, actor: Actor, project_id: uuid.UUID) -> MissionTemplate:
    """Return what to fill in for the next mission, with what the last one said.

    Raises:
        NotFound: the project is not there, or not for this actor.
    """
    return await missions.template_for(db, actor, project_id=project_id)


async def _declared(said: ProjectCreate | ProjectUpdate) -> MetadataFields | None:
    if said.metadata_fields is not None:
        return await asyncio.to_thread(usable_fields, said.metadata_fields)
    return None if said.fields_yaml is None else await asyncio.to_thread(read_fields, said.fields_yaml)


async def _see_that_it_may_change(
    db: Connection, actor: Actor, project_id: uuid.UUID, changed: Mapping[str, object]
) -> None:
    if changed.keys() & _OF_RELEASE:
        admit(actor, "publish_project")
        await require_project(db, actor, "publish_project", project_id)
    if changed.keys() & _OF_QUOTA:
        admit(actor, "set_project_quota")


def _events(new: ProjectRead, before: Metadata, after: Metadata) -> list[Event]:
    """Return what the record says of a change: an event for each right that it took."""
    released = "project.update"
    if "is_public" in after:
        released = "project.publish" if new.is_public else "project.unpublish"
    kinds = {
        ("project.update", "update_project"): after.keys() - _OF_RELEASE - _OF_QUOTA,
        (released, "publish_project"): after.keys() & _OF_RELEASE,
        ("project.set_quota", "set_project_quota"): after.keys() & _OF_QUOTA,
    }
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
        for (operation, takes), names in kinds.items()
        if names
    ]


def _stored(fields: MetadataFields) -> Any:  # Any: JSON, as the column takes it
    return fields.model_dump(mode="json", exclude_none=True)


def _changes(
    old: ProjectRead, changes: ProjectUpdate, fields: MetadataFields | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    held = old.model_dump(mode="json", include={"name", "description", *_OF_RELEASE, *_OF_QUOTA})
    held["metadata_fields"] = _stored(old.metadata_fields)
    given: dict[str, Any] = changes.model_dump(
        exclude={"fields_yaml", "metadata_fields", *_OF_QUOTA}, exclude_none=True
    )
    given |= changes.model_dump(include=_OF_QUOTA, exclude_unset=True)  # of these, null says something
    given |= {} if fields is None else {"metadata_fields": _stored(fields)}
    after = {name: value for name, value in given.items() if value != held[name]}
    return {name: held[name] for name in after}, after


def _name_taken(error: IntegrityError, name: str) -> Exception:
    return NameTaken(noun="project", name=name) if violated_constraint(error) == "uq_project_name_key_live" else error
