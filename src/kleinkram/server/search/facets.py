"""Facets of a query: the values that its files have, how many files have each, and the query with each value selected.

One statement counts all facets: each filter is looked up once, and at most `most` of its files are counted. The
counting part is built once for all requests, because that takes about as long as to count.
"""

import fnmatch
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any, NamedTuple

import psycopg
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
    text,
    true,
    union_all,
)
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.exc import DBAPIError

from kleinkram.contract.files import FileFilter
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.names import name_key
from kleinkram.contract.query import META, is_glob, join_terms, parse, render, terms, terms_of
from kleinkram.contract.search import Facet, FacetsRead, FacetValue
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions, visible_files
from kleinkram.server.db import Connection, among
from kleinkram.server.filters.files import filter_files, filter_topics
from kleinkram.server.filters.plan import SearchPlan, prepare_statement
from kleinkram.server.filters.verdicts import facet_columns
from kleinkram.server.search.planner import ENLARGE_WORK_MEMORY, plan_search, sampled_files
from kleinkram.server.tables import blob, file, mission, project, topic

# Files that are counted, and the time for it; fewer files where that takes too long.
_ATTEMPTS = ((2_000, 5_000), (200, 2_000))
_SET_TIMEOUT = text("SELECT set_config('statement_timeout', :milliseconds, true)")
_MAX_VALUES, _MAX_FIELDS = 12, 20
# A longer value of a metadata field is a text, which nobody selects from a list.
_MAX_CHARACTERS = 80
_PLAIN_FACETS = ("project", "verdict", "check", "format", "content", "month", "label", "topic", "type")
# Facets that only actors who see whole missions get.
_OF_CHECKS = frozenset({"verdict", "check"})
# A file has one value of these, in a column of its own among the files found.
_SINGLE_VALUED = ("project", "verdict", "format", "content", "month")
# A file has several values of these, in a column with an array.
_MULTI_VALUED = {"label": "labels", "check": "failed"}
# JSON types of metadata values that can be selected.
_KINDS = ("string", "number", "boolean")
_FIELD = "^[A-Za-z][A-Za-z0-9_]*$"
# The list in a filter that holds the selected values of a facet.
_LISTS = {
    "verdict": "verdict",
    "check": "check",
    "format": "format",
    "content": "content",
    "topic": "topic",
    "type": "message_type",
    "label": "label",
    "month": "month",
}
_NUMBER = re.compile(r"[-+]?(\d{1,18}|\d{0,18}\.\d{1,18})([eE][-+]?\d{1,2})?", re.ASCII)
_BARE_TEXT = re.compile(r"[^\s*?\"\\]+")


class _FacetRow(NamedTuple):
    """A value of a facet. The row of the empty facet holds the number of all files counted."""

    facet: str
    value: str
    kind: str
    file_count: int
    value_count: int


async def get_facets(db: Connection, actor: Actor, *, query: str) -> FacetsRead:
    """Return the facets of a query, counted over files that this actor may see.

    Where even a few files take too long to find there are none, and the answer is not exact.

    Raises:
        InvalidQuery: the query cannot be read; names the word and its column.
    """
    matching = parse(query)
    filters = _counted_filters(actor, matching)
    plan, sample = await plan_search(db, actor, *filters)
    if plan.finds_nothing:
        return FacetsRead(query=render(matching), file_count=0, is_exact=True, facets=[*_facets(actor, matching, [])])
    common = tuple(sample.is_common(number) for number in range(len(filters)))
    fields = _selected_fields(matching)
    parameters = {"selected_fields": fields, **{f"field_{number}": name for number, name in enumerate(fields)}}
    for max_files, milliseconds in _ATTEMPTS:
        stmt, values = prepare_statement(facet_rows, actor, matching, plan=plan, max_files=max_files, common=common)
        rows = await _run_in_time(db, stmt, values | parameters, milliseconds=milliseconds)
        if rows is not None:
            file_count = next(row.file_count for row in rows if not row.facet)
            is_exact = file_count < max_files and not common[0]
            facets = [*_facets(actor, matching, rows)]
            return FacetsRead(query=render(matching), file_count=file_count, is_exact=is_exact, facets=facets)
    return FacetsRead(query=render(matching), file_count=0, is_exact=False, facets=[])


async def _run_in_time(
    db: Connection, stmt: CompoundSelect[Any], values: Mapping[str, object], *, milliseconds: int
) -> list[_FacetRow] | None:
    """Return the rows of a statement, or None where it takes too long."""
    try:
        async with db.begin_nested():
            await db.execute(ENLARGE_WORK_MEMORY)
            await db.execute(_SET_TIMEOUT, {"milliseconds": str(milliseconds)})
            return [_FacetRow._make(row) for row in await db.execute(stmt, values)]
    except DBAPIError as error:
        if isinstance(error.orig, psycopg.errors.QueryCanceled):
            return None
        raise


def _facets(actor: Actor, matching: FileFilter, rows: Sequence[_FacetRow]) -> Iterator[Facet]:
    names = [*_PLAIN_FACETS, *dict.fromkeys(row.facet for row in rows if row.facet.startswith(META))]
    if sees_whole_missions(actor):
        names += [META + field for field in _selected_fields(matching) if META + field not in names]
    query_terms = terms(matching)
    for name in names if sees_whole_missions(actor) else [name for name in names if name not in _OF_CHECKS]:
        own_rows = [row for row in rows if row.facet == name]
        values = [*_facet_values(matching, query_terms, name, own_rows)]
        if values:
            value_count = max([len(values), *(row.value_count for row in own_rows)])
            yield Facet(name=name, values=values, value_count=value_count)


def _facet_values(
    matching: FileFilter, query_terms: Mapping[str, list[str]], facet: str, rows: Sequence[_FacetRow]
) -> Iterator[FacetValue]:
    selected = _selected_values(matching, facet)
    in_order = sorted(rows, key=lambda row: row.value, reverse=True)
    if facet != "month":
        in_order = sorted(rows, key=lambda row: (-row.file_count, row.value))
    shown = [(row.value, row.file_count, row.kind) for row in in_order if _can_be_selected(row.value, row.kind)]
    # Selected values can be deselected, whether or not they are among the first; globs are no values.
    shown_values = {value for value in selected if any(_is_selected([value], facet, name) for name, *_ in shown)}
    shown += [(value, 0, "string") for value in selected if value not in shown_values and not is_glob(value)]
    # Only the terms of the facet differ from value to value.
    part = META if facet.startswith(META) else facet
    for value, file_count, kind in shown:
        is_selected = _is_selected(selected, facet, value)
        toggled = _deselect(matching, facet, value) if is_selected else _select(matching, facet, value, kind)
        query = join_terms({**query_terms, part: terms_of(part, toggled)})
        yield FacetValue(value=value, file_count=file_count, is_selected=is_selected, query=query)


def _selected_values(matching: FileFilter, facet: str) -> list[str]:
    if facet == "project":
        return [*matching.projects] if matching.project is None else [matching.project, *matching.projects]
    if facet.startswith(META):
        return [value for field, value in map(_equality, matching.where) if field == facet.removeprefix(META)]
    return [str(getattr(value, "value", value)) for value in getattr(matching, _LISTS[facet])]


def _selected_fields(matching: FileFilter) -> list[str]:
    """Return the metadata fields that a filter compares for equality, in order, without nested ones."""
    return sorted({field for field, _ in map(_equality, matching.where) if field and "." not in field})


def _without_facet(matching: FileFilter, facet: str) -> FileFilter:
    """Return a filter without the conditions of a facet."""
    if facet == "project":
        return _changed(matching, project=None, project_id=None, projects=[])
    if facet.startswith(META):
        field = facet.removeprefix(META)
        return _changed(matching, where=[item for item in matching.where if _equality(item)[0] != field])
    return _changed(matching, **{_LISTS[facet]: []})


def _select(matching: FileFilter, facet: str, value: str, kind: str) -> FileFilter:
    """Return a filter with one more value of a facet selected; it replaces others where only one can be."""
    if facet == "project":
        return _changed(matching, project=value, project_id=None, projects=[])
    if facet.startswith(META):
        bare = _without_facet(matching, facet)
        return _changed(bare, where=[*bare.where, _comparison(facet.removeprefix(META), value, kind)])
    selected = _selected_values(matching, facet)
    others = [item for item in selected if item == value or not fnmatch.fnmatchcase(value, item)]
    return _changed(matching, **{_LISTS[facet]: [*others, value]})


def _deselect(matching: FileFilter, facet: str, value: str) -> FileFilter:
    if facet == "project" and matching.projects:
        return _changed(matching, projects=[item for item in matching.projects if name_key(item) != name_key(value)])
    if facet not in _LISTS:
        return _without_facet(matching, facet)
    return _changed(matching, **{_LISTS[facet]: [item for item in _selected_values(matching, facet) if item != value]})


def _is_selected(values: Sequence[str], facet: str, value: str) -> bool:
    return name_key(value) in map(name_key, values) if facet == "project" else value in values


def _can_be_selected(value: str, kind: str) -> bool:
    """Return False for empty values, values of several lines, and numbers of many digits."""
    return bool(value) and "\n" not in value and (kind != "number" or _NUMBER.fullmatch(value) is not None)


def _comparison(field: str, value: str, kind: str) -> str:
    """Return the comparison that is true for just this value of a metadata field."""
    reads_otherwise = _NUMBER.fullmatch(value) is not None or value.lower() in {"true", "false"}
    is_bare = kind != "string" or (_BARE_TEXT.fullmatch(value) is not None and not reads_otherwise)
    return f"{field}={value}" if is_bare else f'{field}="{value}"'


def _equality(expression: str) -> tuple[str, str]:
    """Return field and value of a comparison for equality; two empty texts for any other."""
    match = WHERE_EXPRESSION.fullmatch(expression.strip())
    if match is None or match["operator"] != "=":
        return "", ""
    value = match["value"].strip()
    is_text = len(value) > 1 and value.startswith('"') and value.endswith('"')
    return match["field"], value[1:-1] if is_text else value


def _changed(matching: FileFilter, **changed: Any) -> FileFilter:  # Any: fields of the filter
    # Not validated again, because each value shown has such a filter: it comes from a filter or from the files.
    return matching.model_copy(update=changed)


def _counted_filters(actor: Actor, matching: FileFilter) -> list[FileFilter]:
    """Return the filters whose files are counted: the complete one, and without each facet that it selects from."""
    names = [*_PLAIN_FACETS, *(META + field for field in _selected_fields(matching) if sees_whole_missions(actor))]
    without = [_without_facet(matching, name) for name in names]
    return [matching, *(item for item in without if item != matching)]


def facet_rows(
    actor: Actor, matching: FileFilter, *, plan: SearchPlan, max_files: int, common: Sequence[bool]
) -> CompoundSelect[Any]:
    """Return `_FacetRow` for every facet of a filter.

    A facet with selected values counts the files that would match without it, so that its numbers tell what another
    selection would find. `common` tells for each of the `_counted_filters` whether only the sampled files are counted.
    """
    filters = _counted_filters(actor, matching)

    def found_by(facet: str, name: str) -> CTE:
        facet_filter = _without_facet(matching, facet) if facet else matching
        is_common = common[filters.index(facet_filter)]
        files = filter_files(actor, visible_files(actor), facet_filter, replace(plan, is_common=is_common))
        files = files.with_only_columns(*_columns(), maintain_column_froms=True)
        if is_common:
            files = files.where(file.c.id.in_(select(sample.c.id)))
        return files.limit(max_files).cte(name).prefix_with("MATERIALIZED")

    sample = sampled_files()
    selected = frozenset(facet for facet in _PLAIN_FACETS if _without_facet(matching, facet) != matching)
    files_by_facet = {"": found_by("", "found")} | {
        facet: found_by(facet, f"without_{facet}") for facet in sorted(selected)
    }
    topics = {
        name: _topics(files_by_facet.get(facet, files_by_facet[""]), _without_facet(matching, facet), name)
        for facet, name in _topic_lists(selected).items()
    }
    fields = _selected_fields(matching) if sees_whole_missions(actor) else []
    by_field = [found_by(META + field, f"without_field_{number}") for number, field in enumerate(fields)]
    counts = _counts(selected, len(fields), with_metadata=sees_whole_missions(actor))
    return counts.add_cte(*files_by_facet.values(), *topics.values(), *by_field)


@cache
def _columns() -> tuple[ColumnElement[Any], ...]:
    began = func.to_timestamp(func.floor(file.c.start_ns / 1_000_000_000))
    month = func.to_char(func.timezone("UTC", began), "YYYY-MM").label("month")
    own = (file.c.id, file.c.blob_id, file.c.mission_id, file.c.labels)
    verdict, failed = facet_columns()
    checks = (verdict.label("verdict"), failed.label("failed"))
    return *own, project.c.name.label("project"), *checks, blob.c.format, blob.c.content, month


def _topic_lists(selected: Collection[str]) -> dict[str, str]:
    """Return the CTE with the topics of each of the two facets: one for both where neither has selected values."""
    return {"topic": "topics"} if {"topic", "type"}.isdisjoint(selected) else {"topic": "topics", "type": "types"}


def _topics(files: CTE, matching: FileFilter, name: str) -> CTE:
    """Return parallel lists of `names` and `types` of topics, and the number of `files` that have just these topics."""
    blobs = select(files.c.blob_id, func.count().label("files")).group_by(files.c.blob_id).subquery()
    # Read from the index by blob alone, which holds name and type, in its order and behind OFFSET 0: otherwise
    # PostgreSQL may read all of the index of names or of types.
    own = select(topic.c.name, topic.c.message_type).where(topic.c.blob_id == blobs.c.blob_id)
    own = filter_topics(own, matching).order_by(topic.c.name, topic.c.message_type).offset(0)
    one_topic = own.correlate(blobs).subquery()
    sides = (func.array_agg(one_topic.c.name).label("names"), func.array_agg(one_topic.c.message_type).label("types"))
    topic_lists = select(*sides).lateral("topic_lists")
    file_count = cast(func.sum(blobs.c.files), BigInteger).label("files")
    stmt = select(topic_lists.c.names, topic_lists.c.types, file_count).join_from(blobs, topic_lists, true())
    return stmt.group_by(topic_lists.c.names, topic_lists.c.types).cte(name).prefix_with("MATERIALIZED")


# Enough for what people select in a day, out of many more combinations.
@lru_cache(maxsize=64)
def _counts(selected: frozenset[str], fields: int, *, with_metadata: bool) -> CompoundSelect[Any]:
    """Return the part of `facet_rows` that counts, for selected facets and a number of selected fields.

    It refers to the CTEs by the names that `facet_rows` gives them.
    """
    base = _named("found")
    together = [facet for facet in _SINGLE_VALUED if facet not in selected]
    counted = [_by_column(base, together)] if together else []
    counted += [_by_column(_named(f"without_{facet}"), [facet]) for facet in _SINGLE_VALUED if facet in selected]
    for facet, name in _MULTI_VALUED.items():
        counted.append(_by_item(facet, _named(f"without_{facet}") if facet in selected else base, name))
    topics = _topic_lists(selected)
    counted += [_by_topic("topic", topics["topic"], "names"), _by_topic("type", topics.get("type", "topics"), "types")]
    file_count = _row(literal(""), literal("found"), func.count(), literal(1, BigInteger)).select_from(table("found"))
    parts = [file_count, _first_values(union_all(*counted).subquery())]
    if with_metadata:
        parts.append(_fields(base, None))
        parts += [_fields(_named(f"without_{only}"), only) for only in map("field_{}".format, range(fields))]
    return union_all(*(select(part.subquery()) for part in parts))


def _named(files: str) -> TableClause:
    return table(files, *(column(str(item.key), item.type) for item in _columns()))


def _by_column(files: TableClause, facets: Sequence[str]) -> Select[Any]:
    columns = [files.c[facet] for facet in facets]
    facet = case(*((func.grouping(item) == 0, literal(item.name)) for item in columns))
    value = func.coalesce(*(cast(item, Text) for item in columns))
    stmt = select(facet.label("facet"), value.label("value"), func.count().label("file_count"))
    return stmt.group_by(func.grouping_sets(*columns))


def _by_item(facet: str, files: TableClause, name: str) -> Select[Any]:
    item = func.unnest(files.c[name]).table_valued(column("value", Text)).render_derived(name=f"one_{facet}")
    stmt = select(literal(facet), item.c.value, func.count(distinct(files.c.id)))
    return stmt.join_from(files, item, true()).group_by(item.c.value)


def _by_topic(facet: str, topics: str, side: str) -> Select[Any]:
    sets = table(topics, column(side, ARRAY(Text)), column("files", BigInteger))
    one_value = func.unnest(sets.c[side]).table_valued(column("value", Text)).render_derived(name="one_value")
    once = select(one_value.c.value).distinct().lateral("once")
    stmt = select(literal(facet), once.c.value, cast(func.sum(sets.c.files), BigInteger))
    return stmt.join_from(sets, once, true()).group_by(once.c.value)


def _first_values(counted: Subquery) -> Select[Any]:
    """Return the values of each plain facet that are shown: the most frequent first, but the latest months first."""
    value = counted.c.value.collate("C")
    month = case((counted.c.facet == "month", value), else_=null())
    in_order = (month.desc(), counted.c.file_count.desc(), value)
    rank = func.row_number().over(partition_by=counted.c.facet, order_by=in_order).label("rank")
    value_count = func.count().over(partition_by=counted.c.facet).label("value_count")
    ranked = select(counted, rank, value_count).where(counted.c.value.is_not(None)).subquery()
    row = _row(ranked.c.facet, ranked.c.value, ranked.c.file_count, ranked.c.value_count)
    return row.where(ranked.c.rank <= _MAX_VALUES)


def _fields(files: TableClause, only: str | None) -> Select[Any]:
    """Return the values of one metadata field, or of the fields that most files have and that are not selected."""
    values = _field_values(files).subquery()
    if only is None:
        is_wanted = values.c.key != all_(bindparam("selected_fields", type_=ARRAY(Text)))
    else:
        is_wanted = values.c.key == bindparam(only, type_=Text())
    weight = func.sum(values.c.file_count).over(partition_by=values.c.key)
    in_order = (values.c.file_count.desc(), values.c.value.collate("C"))
    rank = func.row_number().over(partition_by=values.c.key, order_by=in_order)
    value_count = func.count().over(partition_by=values.c.key)
    counted = (rank.label("rank"), weight.label("weight"), value_count.label("value_count"))
    ranked = select(values, *counted).where(is_wanted).subquery()
    facet = literal(META).concat(ranked.c.key)
    row = _row(facet, ranked.c.value, ranked.c.file_count, ranked.c.value_count, kind=ranked.c.kind)
    stmt = row.where(ranked.c.rank <= _MAX_VALUES)
    return stmt.order_by(ranked.c.weight.desc(), ranked.c.key, ranked.c.rank).limit(_MAX_VALUES * _MAX_FIELDS)


def _field_values(files: TableClause) -> Select[Any]:
    """Return `key`, `value`, `kind` and `file_count` of metadata; each item of a list is a value."""
    entries = _metadata_entries(files)
    of_list = cast(case((entries.c.kind == "array", entries.c.value), else_=null()), JSONB)
    item = func.jsonb_array_elements(of_list).table_valued(column("value", JSONB)).render_derived(name="item")
    once = select(*_as_text(item.c.value)).distinct().lateral("once")
    alone = select(entries.c.key, entries.c.value, entries.c.kind, entries.c.files).where(entries.c.kind != "array")
    listed = select(entries.c.key, once.c.value, once.c.kind, entries.c.files).join_from(entries, once, true())
    entry = union_all(alone, listed.where(entries.c.kind == "array")).subquery()
    is_value = (among(entry.c.kind, _KINDS), func.length(entry.c.value) <= _MAX_CHARACTERS)
    file_count = cast(func.sum(entry.c.files), BigInteger).label("file_count")
    columns = (entry.c.key, entry.c.value, entry.c.kind)
    return select(*columns, file_count).where(*is_value, entry.c.key.regexp_match(_FIELD)).group_by(*columns)


def _metadata_entries(files: TableClause) -> CTE:
    """Return `key`, `value` as text, `kind`, and the number of `files` whose mission has it; a list is one value."""
    missions = select(files.c.mission_id, func.count().label("files")).group_by(files.c.mission_id).subquery()
    entry = func.jsonb_each(mission.c.metadata).table_valued(column("key", Text), column("value", JSONB))
    entry = entry.render_derived(name="entry")
    columns = (entry.c.key.label("key"), *_as_text(entry.c.value))
    stmt = select(*columns, func.sum(missions.c.files).label("files"))
    stmt = stmt.join_from(missions, mission, mission.c.id == missions.c.mission_id).join(entry, true())
    return stmt.group_by(*(item.element for item in columns)).cte(f"entries_{files.name}")


def _as_text(value: ColumnElement[Any]) -> tuple[Label[str], Label[str]]:
    as_text = value.op("#>>", return_type=Text())(literal_column("'{}'", ARRAY(Text)))
    return as_text.label("value"), func.jsonb_typeof(value, type_=Text()).label("kind")


def _row(facet: Any, value: Any, file_count: Any, value_count: Any, *, kind: Any = "string") -> Select[Any]:
    kind = literal(kind) if isinstance(kind, str) else kind
    columns = {"facet": facet, "value": value, "kind": kind, "file_count": file_count, "value_count": value_count}
    return select(*(item.label(name) for name, item in columns.items()))
