"""How the files that a filter finds divide. Functions return selects; they touch no connection.

One statement for all facets: each filter is looked up once, and no more than `most` of its files are counted.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import (
    ARRAY,
    CTE,
    BigInteger,
    ColumnElement,
    CompoundSelect,
    Select,
    Text,
    bindparam,
    cast,
    column,
    distinct,
    func,
    literal,
    select,
    true,
    union_all,
)
from sqlalchemy.dialects.postgresql import JSONB, JSONPATH

from kleinkram.contract.files import FileFilter
from kleinkram.contract.query.keys import META
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions, visible_files
from kleinkram.server.search import choosing
from kleinkram.server.search.looking import drawn_files
from kleinkram.server.search.matching import narrow_files, narrow_topics
from kleinkram.server.tables import blob, file, mission, project, topic

MOST_VALUES = 12
MOST_FIELDS = 20
# A longer value of a metadata field is a text, which nobody chooses from a list.
_MOST_CHARACTERS = 80
PLAIN_FACETS = ("project", "format", "content", "month", "label", "topic", "type")
_FIELD = "^[A-Za-z][A-Za-z0-9_]*$"


def variants(actor: Actor, matching: FileFilter) -> list[FileFilter]:
    """Return the filters whose files are counted: the whole one, and without each thing that is chosen."""
    names = [*PLAIN_FACETS, *(META + field for field in choosing.fields(matching) if sees_whole_missions(actor))]
    without = [choosing.without(matching, name) for name in names]
    return [matching, *(each for each in without if each != matching)]


def facet_rows(
    actor: Actor, matching: FileFilter, *, most: int, many: Collection[FileFilter] = ()
) -> CompoundSelect[Any]:
    """Return rows of `facet`, `value`, `kind`, `file_count`, `value_count` for every facet of a filter.

    The row of the empty facet holds how many files were looked at. A facet of which something is chosen counts the
    files that would be found if nothing of it were, so that its numbers say what another choice would find. Of the
    filters that find `many`, only files drawn by lot are looked at.
    """

    def found_by(each: FileFilter, name: str) -> CTE:
        is_drawn = each in many
        as_drawn = replace(actor, looked=replace(actor.looked, finds_many=is_drawn))
        return _found(as_drawn, each, name, most, is_drawn=is_drawn)

    base = found_by(matching, "found")
    looked_at = _row(literal(""), literal(""), func.count(), literal(1, BigInteger)).select_from(base)
    parts: list[Select[Any]] = [looked_at]
    for facet in PLAIN_FACETS:
        is_chosen = choosing.without(matching, facet) != matching
        found = found_by(choosing.without(matching, facet), f"but_{facet}") if is_chosen else base
        parts.append(_top(facet, _counted(facet, found, choosing.without(matching, facet))))
    if sees_whole_missions(actor):
        asked = choosing.fields(matching)
        parts.append(_fields(base, None, leaving_out=asked))
        for number, field in enumerate(asked):
            open_ = choosing.without(matching, META + field)
            parts.append(_fields(found_by(open_, f"but_field_{number}"), field))
    return union_all(*(select(part.subquery()) for part in parts))


def _found(actor: Actor, matching: FileFilter, name: str, most: int, *, is_drawn: bool) -> CTE:
    columns = (
        file.c.id,
        file.c.blob_id,
        file.c.mission_id,
        file.c.labels,
        project.c.name.label("project"),
        blob.c.format,
        blob.c.content,
        file.c.start_ns,
    )
    found = narrow_files(actor, visible_files(actor), matching).with_only_columns(*columns, maintain_column_froms=True)
    if is_drawn:
        found = found.where(file.c.id.in_(select(drawn_files().c.id)))
    return found.limit(most).cte(name).prefix_with("MATERIALIZED")


def _counted(facet: str, found: CTE, matching: FileFilter) -> Select[Any]:
    """Return `value` and `file_count` of a facet; topic and type are asked of one topic together."""
    if facet in {"topic", "type"}:
        # Read from the index by blob alone, which holds name and type.
        blobs = select(found.c.blob_id, func.count().label("files")).group_by(found.c.blob_id).subquery()
        named = topic.c.name if facet == "topic" else topic.c.message_type
        each = narrow_topics(select(named.label("value")).where(topic.c.blob_id == blobs.c.blob_id), matching)
        # Said of the name too, although each has one: else the index of types is taken, and skipped through by blob.
        once = each.where(named.is_not(None)).group_by(named).having(func.count(topic.c.name) > 0).lateral("once")
        file_count = cast(func.sum(blobs.c.files), BigInteger)
        return (
            select(once.c.value, file_count.label("file_count")).join_from(blobs, once, true()).group_by(once.c.value)
        )
    if facet == "label":
        label = func.unnest(found.c.labels).table_valued(column("value", Text)).render_derived(name="label")
        stmt = select(label.c.value, func.count(distinct(found.c.id)).label("file_count"))
        return stmt.join_from(found, label, true()).group_by(label.c.value)
    value: ColumnElement[Any] = found.c[facet] if facet != "month" else _month(found)
    return select(value.label("value"), func.count().label("file_count")).where(value.is_not(None)).group_by(value)


def _month(found: CTE) -> ColumnElement[Any]:
    began = func.to_timestamp(func.floor(found.c.start_ns / 1_000_000_000))
    return func.to_char(func.timezone("UTC", began), "YYYY-MM")


def _top(facet: str, counted: Select[Any]) -> Select[Any]:
    values = counted.subquery()
    value_count = func.count().over()
    first = [values.c.value.desc()] if facet == "month" else [values.c.file_count.desc(), values.c.value]
    row = _row(literal(facet), cast(values.c.value, Text), values.c.file_count, value_count)
    return row.order_by(*first).limit(MOST_VALUES)


def _fields(found: CTE, only: str | None, *, leaving_out: Sequence[str] = ()) -> Select[Any]:
    """Return the values of metadata fields: of one field, or of those that most files have."""
    values = _field_values(found).subquery()
    weight = func.sum(values.c.file_count).over(partition_by=values.c.key)
    in_order = (values.c.file_count.desc(), values.c.value)
    place = func.row_number().over(partition_by=values.c.key, order_by=in_order)
    value_count = func.count().over(partition_by=values.c.key)
    chosen = values.c.key.not_in(leaving_out) if only is None else values.c.key == only
    counted = (place.label("place"), weight.label("weight"), value_count.label("value_count"))
    ranked = select(values, *counted).where(chosen).subquery()
    facet = literal(META).concat(ranked.c.key)
    row = _row(facet, ranked.c.value, ranked.c.file_count, ranked.c.value_count, kind=ranked.c.kind)
    stmt = row.where(ranked.c.place <= MOST_VALUES)
    return stmt.order_by(ranked.c.weight.desc(), ranked.c.key, ranked.c.place).limit(MOST_VALUES * MOST_FIELDS)


def _field_values(found: CTE) -> Select[Any]:
    """Return `key`, `value`, `kind` and `file_count` of what missions say; each item of a list is a value."""
    missions = select(found.c.mission_id, func.count().label("files")).group_by(found.c.mission_id).subquery()
    entry = func.jsonb_each(mission.c.metadata).table_valued(column("key", Text), column("value", JSONB))
    entry = entry.render_derived(name="entry")
    item = func.jsonb_path_query(entry.c.value, cast("lax $[*]", JSONPATH)).table_valued(column("value", JSONB))
    item = item.render_derived(name="item")
    kind = func.jsonb_typeof(item.c.value)
    text = item.c.value.op("#>>", return_type=Text())(bindparam(None, [], ARRAY(Text)))
    once = select(missions, entry.c.key.label("key"), text.label("value"), kind.label("kind")).distinct()
    once = once.join_from(missions, mission, mission.c.id == missions.c.mission_id)
    once = once.join(entry, true()).join(item, true())
    is_value = (kind.in_(["string", "number", "boolean"]), func.length(text) <= _MOST_CHARACTERS)
    said = once.where(*is_value, entry.c.key.regexp_match(_FIELD)).subquery()
    file_count = cast(func.sum(said.c.files), BigInteger).label("file_count")
    columns = (said.c.key, said.c.value, said.c.kind)
    return select(*columns, file_count).group_by(*columns)


def _row(facet: Any, value: Any, file_count: Any, value_count: Any, *, kind: Any = "string") -> Select[Any]:
    kind = literal(kind) if isinstance(kind, str) else kind
    columns = {"facet": facet, "value": value, "kind": kind, "file_count": file_count, "value_count": value_count}
    return select(*(each.label(name) for name, each in columns.items()))
