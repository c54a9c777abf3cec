"""How the files that a filter finds divide. Functions return selects; they touch no connection.

One statement for all facets: each filter is looked up once, and no more than `most` of its files are counted. What
counts is put together once for all requests, as that takes about as long as to count; what finds is each request's.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any

from sqlalchemy import (
    ARRAY,
    CTE,
    BigInteger,
    ColumnElement,
    CompoundSelect,
    Label,
    Select,
    Subquery,
    TableClause,
    Text,
    all_,
    bindparam,
    case,
    cast,
    column,
    distinct,
    func,
    literal,
    literal_column,
    null,
    select,
    table,
    true,
    union_all,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.files import FileFilter
from kleinkram.contract.query import META
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions, visible_files
from kleinkram.server.db import among
from kleinkram.server.filters.files import filter_files, filter_topics
from kleinkram.server.filters.plan import SearchPlan
from kleinkram.server.search import chosen_values
from kleinkram.server.search.planner import sampled_files
from kleinkram.server.tables import blob, file, mission, project, topic

MOST_VALUES = 12
MOST_FIELDS = 20
# A longer value of a metadata field is a text, which nobody chooses from a list.
_MOST_CHARACTERS = 80
PLAIN_FACETS = ("project", "format", "content", "month", "label", "topic", "type")
# Of these a file has one value, in a column of its own among what was found.
_OF_FILES = ("project", "format", "content", "month")
# What a value of a metadata field is, where it can be chosen.
_KINDS = ("string", "number", "boolean")
_FIELD = "^[A-Za-z][A-Za-z0-9_]*$"


def variants(actor: Actor, matching: FileFilter) -> list[FileFilter]:
    """Return the filters whose files are counted: the whole one, and without each thing that is chosen."""
    names = [*PLAIN_FACETS, *(META + field for field in chosen_values.fields(matching) if sees_whole_missions(actor))]
    without = [chosen_values.without(matching, name) for name in names]
    return [matching, *(item for item in without if item != matching)]


def facet_rows(
    actor: Actor, matching: FileFilter, *, plan: SearchPlan, most: int, common: Sequence[bool]
) -> CompoundSelect[Any]:
    """Return rows of `facet`, `value`, `kind`, `file_count`, `value_count` for every facet of a filter.

    The row of the empty facet holds how many files were counted. A facet of which something is chosen counts the files
    that would match if nothing of it were, so that its numbers say what another choice would find. `common` says of
    each of the `variants` whether only the sampled files are looked at.
    """
    each_filter = variants(actor, matching)

    def found_by(facet: str, name: str) -> CTE:
        facet_filter = chosen_values.without(matching, facet) if facet else matching
        is_common = common[each_filter.index(facet_filter)]
        files = filter_files(actor, visible_files(actor), facet_filter, replace(plan, is_common=is_common))
        files = files.with_only_columns(*_columns(), maintain_column_froms=True)
        if is_common:
            files = files.where(file.c.id.in_(select(sample.c.id)))
        return files.limit(most).cte(name).prefix_with("MATERIALIZED")

    sample = sampled_files()
    chosen = frozenset(facet for facet in PLAIN_FACETS if chosen_values.without(matching, facet) != matching)
    files_by_facet = {"": found_by("", "found")} | {facet: found_by(facet, f"but_{facet}") for facet in sorted(chosen)}
    topics = {
        name: _topics(files_by_facet.get(facet, files_by_facet[""]), chosen_values.without(matching, facet), name)
        for facet, name in _topics_of(chosen).items()
    }
    chosen_fields = chosen_values.fields(matching) if sees_whole_missions(actor) else []
    fields = [found_by(META + field, f"but_field_{number}") for number, field in enumerate(chosen_fields)]
    counts = _counts(chosen, len(chosen_fields), with_metadata=sees_whole_missions(actor))
    return counts.add_cte(*files_by_facet.values(), *topics.values(), *fields)


def parameters(matching: FileFilter) -> dict[str, object]:
    """Return the bind parameters of `facet_rows`: the metadata fields that a filter names."""
    names = chosen_values.fields(matching)
    return {"chosen_fields": names, **{f"field_{number}": name for number, name in enumerate(names)}}


@cache
def _columns() -> tuple[ColumnElement[Any], ...]:
    began = func.to_timestamp(func.floor(file.c.start_ns / 1_000_000_000))
    month = func.to_char(func.timezone("UTC", began), "YYYY-MM").label("month")
    own = (file.c.id, file.c.blob_id, file.c.mission_id, file.c.labels)
    return *own, project.c.name.label("project"), blob.c.format, blob.c.content, month


def _topics_of(chosen: Collection[str]) -> dict[str, str]:
    """Return the names under which topics are read for their facet; once for both where neither is chosen."""
    return {"topic": "topics"} if {"topic", "type"}.isdisjoint(chosen) else {"topic": "topics", "type": "types"}


def _topics(files: CTE, matching: FileFilter, name: str) -> CTE:
    """Return `names` and `types` of topics side by side, and how many `files` have just these: many have the same."""
    blobs = select(files.c.blob_id, func.count().label("files")).group_by(files.c.blob_id).subquery()
    # Read from the index by blob alone, which holds name and type, in its order and behind OFFSET 0: else the index of
    # names or that of types may be gone through.
    own = select(topic.c.name, topic.c.message_type).where(topic.c.blob_id == blobs.c.blob_id)
    own = filter_topics(own, matching).order_by(topic.c.name, topic.c.message_type).offset(0)
    one_topic = own.correlate(blobs).subquery()
    sides = (func.array_agg(one_topic.c.name).label("names"), func.array_agg(one_topic.c.message_type).label("types"))
    topic_lists = select(*sides).lateral("topic_lists")
    file_count = cast(func.sum(blobs.c.files), BigInteger).label("files")
    stmt = select(topic_lists.c.names, topic_lists.c.types, file_count).join_from(blobs, topic_lists, true())
    return stmt.group_by(topic_lists.c.names, topic_lists.c.types).cte(name).prefix_with("MATERIALIZED")


# As much is kept as people choose in a day; what can be chosen together is a lot more.
@lru_cache(maxsize=64)
def _counts(chosen: frozenset[str], fields: int, *, with_metadata: bool) -> CompoundSelect[Any]:
    """Return what counts, where some facets are chosen and so many metadata fields asked for.

    The files that were found, and their topics, it takes to be there under the names that `facet_rows` gives them.
    """
    base = _named("found")
    together = [facet for facet in _OF_FILES if facet not in chosen]
    counted = [_by_column(base, together)] if together else []
    counted += [_by_column(_named(f"but_{facet}"), [facet]) for facet in _OF_FILES if facet in chosen]
    counted.append(_by_label(_named("but_label") if "label" in chosen else base))
    topics = _topics_of(chosen)
    counted += [_by_topic("topic", topics["topic"], "names"), _by_topic("type", topics.get("type", "topics"), "types")]
    parts = [_found_count(), _top(union_all(*counted).subquery())]
    if with_metadata:
        parts.append(_fields(base, None))
        parts += [_fields(_named(f"but_{only}"), only) for only in map("field_{}".format, range(fields))]
    return union_all(*(select(part.subquery()) for part in parts))


def _named(files: str) -> TableClause:
    return table(files, *(column(str(item.key), item.type) for item in _columns()))


def _found_count() -> Select[Any]:
    return _row(literal(""), literal("found"), func.count(), literal(1, BigInteger)).select_from(table("found"))


def _by_column(files: TableClause, facets: Sequence[str]) -> Select[Any]:
    columns = [files.c[facet] for facet in facets]
    facet = case(*((func.grouping(item) == 0, literal(item.name)) for item in columns))
    value = func.coalesce(*(cast(item, Text) for item in columns))
    stmt = select(facet.label("facet"), value.label("value"), func.count().label("file_count"))
    return stmt.group_by(func.grouping_sets(*columns))


def _by_label(files: TableClause) -> Select[Any]:
    label = func.unnest(files.c.labels).table_valued(column("value", Text)).render_derived(name="label")
    stmt = select(literal("label"), label.c.value, func.count(distinct(files.c.id)))
    return stmt.join_from(files, label, true()).group_by(label.c.value)


def _by_topic(facet: str, topics: str, side: str) -> Select[Any]:
    sets = table(topics, column(side, ARRAY(Text)), column("files", BigInteger))
    one_value = func.unnest(sets.c[side]).table_valued(column("value", Text)).render_derived(name="held")
    once = select(one_value.c.value).distinct().lateral("once")
    stmt = select(literal(facet), once.c.value, cast(func.sum(sets.c.files), BigInteger))
    return stmt.join_from(sets, once, true()).group_by(once.c.value)


def _top(counted: Subquery) -> Select[Any]:
    """Return the values of each plain facet that are shown: the most frequent first, months the latest."""
    value = counted.c.value.collate("C")
    month = case((counted.c.facet == "month", value), else_=null())
    in_order = (month.desc(), counted.c.file_count.desc(), value)
    place = func.row_number().over(partition_by=counted.c.facet, order_by=in_order).label("place")
    value_count = func.count().over(partition_by=counted.c.facet).label("value_count")
    ranked = select(counted, place, value_count).where(counted.c.value.is_not(None)).subquery()
    row = _row(ranked.c.facet, ranked.c.value, ranked.c.file_count, ranked.c.value_count)
    return row.where(ranked.c.place <= MOST_VALUES)


def _fields(files: TableClause, only: str | None) -> Select[Any]:
    """Return the values of metadata fields: of one field, or of those that most files have, and not asked for."""
    values = _field_values(files).subquery()
    if only is None:
        is_wanted = values.c.key != all_(bindparam("chosen_fields", type_=ARRAY(Text)))
    else:
        is_wanted = values.c.key == bindparam(only, type_=Text())
    weight = func.sum(values.c.file_count).over(partition_by=values.c.key)
    in_order = (values.c.file_count.desc(), values.c.value.collate("C"))
    place = func.row_number().over(partition_by=values.c.key, order_by=in_order)
    value_count = func.count().over(partition_by=values.c.key)
    counted = (place.label("place"), weight.label("weight"), value_count.label("value_count"))
    ranked = select(values, *counted).where(is_wanted).subquery()
    facet = literal(META).concat(ranked.c.key)
    row = _row(facet, ranked.c.value, ranked.c.file_count, ranked.c.value_count, kind=ranked.c.kind)
    stmt = row.where(ranked.c.place <= MOST_VALUES)
    return stmt.order_by(ranked.c.weight.desc(), ranked.c.key, ranked.c.place).limit(MOST_VALUES * MOST_FIELDS)


def _field_values(files: TableClause) -> Select[Any]:
    """Return `key`, `value`, `kind` and `file_count` of what missions say; each item of a list is a value."""
    entries = _metadata_entries(files)
    of_list = cast(case((entries.c.kind == "array", entries.c.value), else_=null()), JSONB)
    item = func.jsonb_array_elements(of_list).table_valued(column("value", JSONB)).render_derived(name="item")
    once = select(*_as_text(item.c.value)).distinct().lateral("once")
    alone = select(entries.c.key, entries.c.value, entries.c.kind, entries.c.files).where(entries.c.kind != "array")
    listed = select(entries.c.key, once.c.value, once.c.kind, entries.c.files).join_from(entries, once, true())
    entry = union_all(alone, listed.where(entries.c.kind == "array")).subquery()
    is_value = (among(entry.c.kind, _KINDS), func.length(entry.c.value) <= _MOST_CHARACTERS)
    file_count = cast(func.sum(entry.c.files), BigInteger).label("file_count")
    columns = (entry.c.key, entry.c.value, entry.c.kind)
    return select(*columns, file_count).where(*is_value, entry.c.key.regexp_match(_FIELD)).group_by(*columns)


def _metadata_entries(files: TableClause) -> CTE:
    """Return `key`, `value` as text, `kind`, and of how many `files` the mission says so; a list as a whole."""
    missions = select(files.c.mission_id, func.count().label("files")).group_by(files.c.mission_id).subquery()
    entry = func.jsonb_each(mission.c.metadata).table_valued(column("key", Text), column("value", JSONB))
    entry = entry.render_derived(name="entry")
    columns = (entry.c.key.label("key"), *_as_text(entry.c.value))
    stmt = select(*columns, func.sum(missions.c.files).label("files"))
    stmt = stmt.join_from(missions, mission, mission.c.id == missions.c.mission_id).join(entry, true())
    return stmt.group_by(*(item.element for item in columns)).cte(f"entries_{files.name}")


def _as_text(value: ColumnElement[Any]) -> tuple[Label[str], Label[str]]:
    text = value.op("#>>", return_type=Text())(literal_column("'{}'", ARRAY(Text)))
    return text.label("value"), func.jsonb_typeof(value, type_=Text()).label("kind")


def _row(facet: Any, value: Any, file_count: Any, value_count: Any, *, kind: Any = "string") -> Select[Any]:
    kind = literal(kind) if isinstance(kind, str) else kind
    columns = {"facet": facet, "value": value, "kind": kind, "file_count": file_count, "value_count": value_count}
    return select(*(item.label(name) for name, item in columns.items()))
