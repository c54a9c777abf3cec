"""Where missions were recorded: the first positions of their recordings, else those in their metadata.

Positions are those of the previews of recordings, whose bytes nobody believes: they are in range, and may be wrong.
"""

from typing import Any

from sqlalchemy import (
    ColumnElement,
    Double,
    Numeric,
    Select,
    Subquery,
    Text,
    cast,
    column,
    false,
    func,
    literal,
    literal_column,
    select,
    true,
)
from sqlalchemy.dialects.postgresql import JSONB, JSONPATH
from sqlalchemy.sql.selectable import LateralFromClause

from kleinkram.contract.files import FileFilter
from kleinkram.contract.metadata import FieldType
from kleinkram.contract.mission_positions import (
    MAX_PLACED_MISSIONS,
    MissionPosition,
    MissionPositions,
    PositionSource,
)
from kleinkram.contract.missions import MissionFilter, MissionSort
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions, shown_files, visible_missions
from kleinkram.server.db import Connection
from kleinkram.server.filters.missions import filter_missions, filter_missions_by_files
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan, prepare_statement
from kleinkram.server.missions.queries import mission_listing, mission_order, mission_ref
from kleinkram.server.pagination import in_order
from kleinkram.server.tables import DERIVED_ORIGIN, file, mission, project

_LATEST = MissionSort.start_desc
# `strict`: no array stands for its elements. What is no number is not in range.
_IN_RANGE = "strict $ ? (@.latitude >= -90 && @.latitude <= 90 && @.longitude >= -180 && @.longitude <= 180)"
_DECIMALS = 7  # a centimetre; PostgreSQL refuses to make a float of a number that is nearly zero


async def list_mission_positions(
    db: Connection, actor: Actor, *, matching: MissionFilter, by_files: FileFilter | None = None
) -> MissionPositions:
    """Return where missions were recorded that match; with `by_files`, as in `list_missions`.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    filters = [matching] if by_files is None else [matching, by_files]
    rows = (await db.execute(*prepare_statement(_latest_positions, actor, *filters))).all()
    left_out_count = 0
    if len(rows) > MAX_PLACED_MISSIONS:
        rows = rows[:MAX_PLACED_MISSIONS]
        listing, values = prepare_statement(mission_listing, actor, *filters, sort=_LATEST)
        left_out_count = (await db.execute(listing.count, values)).scalar_one() - len(rows)
    items = [
        MissionPosition(
            mission=mission_ref(row.id, row.name, row.project_id, row.project_name),
            latitude=row.latitude,
            longitude=row.longitude,
            source=PositionSource.recording if row.is_recorded else PositionSource.metadata,
        )
        for row in rows
        if row.latitude is not None
    ]
    return MissionPositions(items=items, unplaced_count=len(rows) - len(items), left_out_count=left_out_count)


def _latest_positions(
    actor: Actor, matching: MissionFilter, by_files: FileFilter | None = None, *, plan: SearchPlan = NO_PLAN
) -> Select[Any]:
    """Return the latest missions that match, one more than are shown, with their positions; null where unknown."""
    matched = filter_missions(actor, visible_missions(actor), matching, plan)
    if by_files is not None:
        matched = filter_missions_by_files(actor, matched, by_files, plan)
    columns = (
        *(mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name")),
        *(mission.c.metadata, project.c.metadata_fields),
    )
    order = mission_order(actor, _LATEST)
    keys = [column.label(f"key_{number}") for number, column in enumerate(order.columns)]
    latest = matched.with_only_columns(*columns, *keys, maintain_column_froms=True)
    listed = in_order(latest, order.columns, order).limit(MAX_PLACED_MISSIONS + 1).subquery("latest")
    recorded, declared = _recorded_position(actor, listed), _declared_position(actor, listed)
    placed = (
        select(
            *(listed.c.id, listed.c.name, listed.c.project_id, listed.c.project_name),
            recorded.c.latitude.is_not(None).label("is_recorded"),
            func.coalesce(recorded.c.latitude, declared.c.latitude).label("latitude"),
            func.coalesce(recorded.c.longitude, declared.c.longitude).label("longitude"),
        )
        .select_from(listed)
        .outerjoin(recorded, true())
        .outerjoin(declared, true())
    )
    return in_order(placed, (listed.c[key.name] for key in keys), order)


def _recorded_position(actor: Actor, listed: Subquery) -> LateralFromClause:
    """Return the first position of each mission's recordings that are shown to `actor`."""
    stmt = select(file.c.latitude, file.c.longitude).where(
        file.c.mission_id == listed.c.id,
        file.c.deleted_at.is_(None),
        # A literal: the condition of the index.
        file.c.origin != literal_column(f"'{DERIVED_ORIGIN}'"),
        file.c.latitude.is_not(None),
        shown_files(actor),
    )
    return stmt.order_by(file.c.start_ns.asc().nulls_last(), file.c.id).limit(1).lateral("recorded")


def _declared_position(actor: Actor, listed: Subquery) -> LateralFromClause:
    """Return the first usable location in each mission's metadata, if the actor sees metadata."""
    fields = func.jsonb_array_elements(listed.c.metadata_fields["fields"])
    listed_fields = fields.table_valued(column("entry", JSONB), with_ordinality="number").render_derived(name="field")
    entry: ColumnElement[Any] = listed_fields.c.entry
    place = _part(listed.c.metadata, entry["name"].astext)

    def degrees(name: str) -> ColumnElement[float]:
        return cast(func.round(cast(_part(place, literal(name, Text)), Numeric), _DECIMALS), Double)

    stmt = select(degrees("latitude").label("latitude"), degrees("longitude").label("longitude"))
    stmt = stmt.select_from(listed_fields).where(
        true() if sees_whole_missions(actor) else false(),
        entry["type"].astext == FieldType.location.value,
        func.jsonb_path_exists(place, cast(_IN_RANGE, JSONPATH)),
    )
    return stmt.order_by(listed_fields.c.number).limit(1).lateral("declared")


def _part(value: ColumnElement[Any], key: ColumnElement[str]) -> ColumnElement[Any]:
    return value.op("->", return_type=JSONB())(key)
