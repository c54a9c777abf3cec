"""Previews of missions: of each action, those of the latest run that is done and has any."""

import base64
import datetime
import uuid
from collections import Counter
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, column, func, select, true
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.actions import ActionDefinition, ParametersWrong
from kleinkram.contract.previews import (
    MAX_LISTED_PICTURE_BYTES,
    MAX_MISSION_PREVIEWS,
    PICTURE_ENDINGS,
    PREVIEW_ACTION,
    MissionPicture,
    MissionPictures,
    MissionPreview,
    MissionPreviews,
    MissionThumbnail,
    preview_kind,
)
from kleinkram.contract.runs import ActionRef, RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission
from kleinkram.server.access.visible import visible_files
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.runs.declared_inputs import DeclaredInputs, read_declared_inputs
from kleinkram.server.runs.launch import inputs_fingerprint
from kleinkram.server.runs.project_results import PresentInput, present_inputs
from kleinkram.server.runs.queries import ACTION_NAME, visible_runs
from kleinkram.server.runs.service import UNREADABLE
from kleinkram.server.tables import (
    action,
    action_version,
    blob,
    file,
    project,
    recording_preview,
    run,
    run_artifact,
)

_IS_PICTURE = rf"\.({'|'.join(PICTURE_ENDINGS)})$"


async def list_mission_previews(db: Connection, actor: Actor, *, mission_id: uuid.UUID) -> MissionPreviews:
    """Return the first previews of a mission.

    Raises:
        NotFound: the mission is not there, or not for this actor.
    """
    await require_mission(db, actor, "list_mission_previews", mission_id)
    stmt, order = _previews(actor, [mission_id])
    rows = (await db.execute(stmt.order_by(*order).limit(MAX_MISSION_PREVIEWS + 1))).all()
    shown = rows[:MAX_MISSION_PREVIEWS]
    outdated = await _outdated(db, mission_id, shown)
    items = [_to_preview(row, outdated=row.run_id in outdated) for row in shown]
    return MissionPreviews(items=items, truncated=len(rows) > len(items))


async def get_mission_pictures(
    context: AppContext, actor: Actor, *, mission_ids: Sequence[uuid.UUID]
) -> MissionPictures:
    """Return a picture of each visible mission that has one, and record for each project that it was viewed.

    Three statements for any number of missions.
    """
    async with context.database.begin() as db:
        rows = (await db.execute(_first_pictures(actor, mission_ids))).all()
        others = set(mission_ids) - {row.mission_id for row in rows}
        thumbnails = (await db.execute(_thumbnails(actor, others))).all() if others else []
        shown = [*rows, *thumbnails]
        names = {row.project_id: row.project_name for row in shown}
        counts = Counter(row.project_id for row in shown)
        events = [
            Event("project.preview", "project", project_id, names[project_id], project_id, after={"missions": count})
            for project_id, count in counts.items()
        ]
        await audit(db, actor, *events)
    expires_s = context.settings.download_url_s
    expires_at = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=expires_s)
    names_of_fields = MissionPicture.model_fields.keys() - {"url", "expires_at"}
    return MissionPictures(
        items=[
            MissionPicture(
                **{name: getattr(row, name) for name in names_of_fields},
                url=context.storage.sign_get(row.key, path=row.path, expires_s=expires_s),
                expires_at=expires_at,
            )
            for row in rows
        ],
        thumbnails=[
            MissionThumbnail(
                mission_id=row.mission_id, file_id=row.file_id, jpeg=base64.b64encode(row.thumbnail).decode()
            )
            for row in thumbnails
        ],
    )


def _thumbnails(actor: Actor, mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return a thumbnail of each mission whose recordings have one: that of the largest of them."""
    columns = (file.c.mission_id, file.c.id.label("file_id"), recording_preview.c.thumbnail)
    of_project = (project.c.id.label("project_id"), project.c.name.label("project_name"))
    stmt = visible_files(actor).with_only_columns(*columns, *of_project, maintain_column_froms=True)
    stmt = stmt.join(recording_preview, recording_preview.c.blob_id == file.c.blob_id)
    stmt = stmt.where(among(file.c.mission_id, mission_ids), recording_preview.c.thumbnail.is_not(None))
    return stmt.distinct(file.c.mission_id).order_by(file.c.mission_id, blob.c.size_bytes.desc(), file.c.id)


def _first_pictures(actor: Actor, mission_ids: Sequence[uuid.UUID]) -> Select[Any]:
    stmt, order = _previews(actor, mission_ids)
    pictures = stmt.where(
        run_artifact.c.path.regexp_match(_IS_PICTURE, flags="i"), blob.c.size_bytes <= MAX_LISTED_PICTURE_BYTES
    )
    mission_id = stmt.selected_columns.mission_id
    return pictures.distinct(mission_id).order_by(mission_id, *order)


def _previews(actor: Actor, mission_ids: Sequence[uuid.UUID]) -> tuple[Select[Any], Sequence[ColumnElement[Any]]]:
    """Return the previews of missions, and the order of those of one mission."""
    latest = _latest_runs(actor, mission_ids).subquery("latest")
    made = run.alias("made")
    listed = func.jsonb_array_elements(latest.c.previews).table_valued(column("entry", JSONB), with_ordinality="number")
    listed = listed.render_derived(name="listed")
    of_run = [one for one in latest.c if one.name != "previews"]
    title = func.coalesce(listed.c.entry["title"].astext, "").label("title")
    of_artifact = (run_artifact.c.id.label("artifact_id"), run_artifact.c.path, title)
    columns = (*of_run, made.c.ended_at, *of_artifact, blob.c.size_bytes, blob.c.sha256, blob.c.key)
    stmt = (
        select(*columns)
        .select_from(latest)
        .join(made, made.c.id == latest.c.run_id)
        .join(listed, true())
        .join(
            run_artifact, (run_artifact.c.run_id == made.c.id) & (run_artifact.c.path == listed.c.entry["path"].astext)
        )
        .join(blob, blob.c.id == run_artifact.c.blob_id)
        .where(blob.c.state.not_in(UNREADABLE))
    )
    is_first = latest.c.action_name == PREVIEW_ACTION
    return stmt, (is_first.desc(), made.c.ended_at.desc(), made.c.id, listed.c.number)


def _latest_runs(actor: Actor, mission_ids: Sequence[uuid.UUID]) -> Select[Any]:
    """Return the latest run of each action on each mission that is done and has previews; `run_id` made them."""
    # By name: an action that is archived and published again is one action to people.
    name = func.coalesce(action.c.name, ACTION_NAME)
    columns = (
        *(run.c.mission_id, func.coalesce(run.c.reuses_id, run.c.id).label("run_id"), run.c.version_id),
        *(run.c.parameters, run.c.inputs_fingerprint, run.c.previews),
        *(action.c.id.label("action_id"), name.label("action_name"), action_version.c.number.label("action_number")),
        *(project.c.id.label("project_id"), project.c.name.label("project_name")),
    )
    stmt = visible_runs(actor).with_only_columns(*columns, maintain_column_froms=True)
    with_previews = (run.c.state == RunState.done.value) & (func.jsonb_array_length(run.c.previews) > 0)
    stmt = stmt.where(among(run.c.mission_id, mission_ids), with_previews).distinct(run.c.mission_id, name)
    return stmt.order_by(run.c.mission_id, name, run.c.created_at.desc(), run.c.id.desc())


async def _outdated(db: Connection, mission_id: uuid.UUID, rows: Sequence[Row[Any]]) -> set[uuid.UUID]:
    """Return those of the runs with these previews whose inputs are not the present ones."""
    columns = (action_version.c.id, action_version.c.definition)
    stmt = select(*columns).where(among(action_version.c.id, {row.version_id for row in rows}))
    definitions = {row.id: ActionDefinition.model_validate(row.definition) for row in await db.execute(stmt)}
    present: dict[str, tuple[Sequence[PresentInput], DeclaredInputs]] = {}  # most actions read the same files
    outdated = set()
    for row in {row.run_id: row for row in rows}.values():
        definition = definitions[row.version_id]
        inputs = definition.inputs.model_dump_json()
        if inputs not in present:
            files = await present_inputs(db, definition, [mission_id])
            declared = await read_declared_inputs(db, definition.inputs, [mission_id])
            present[inputs] = files.get(mission_id, ()), declared[mission_id]
        try:
            parameters = definition.fill_in(row.parameters)
        except ParametersWrong:  # the rules for parameters became stricter
            outdated.add(row.run_id)
            continue
        if inputs_fingerprint(row.version_id, parameters, *present[inputs]) != row.inputs_fingerprint:
            outdated.add(row.run_id)
    return outdated


def _to_preview(row: Row[Any], *, outdated: bool) -> MissionPreview:
    return MissionPreview(
        **{name: getattr(row, name) for name in ("run_id", "artifact_id", "path", "title", "size_bytes")},
        action=ActionRef(id=row.action_id, name=row.action_name, version=row.action_number),
        made_at=row.ended_at,
        outdated=outdated,
        kind=preview_kind(row.path),
        sha256=row.sha256.hex(),
    )
