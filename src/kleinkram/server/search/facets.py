"""Facets: how what a query finds divides, and the query with each part chosen. Bounded in files and in time."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import psycopg
from sqlalchemy import CompoundSelect, Row, text
from sqlalchemy.exc import DBAPIError

from kleinkram.contract.files import FileFilter
from kleinkram.contract.query import META, is_glob, join_terms, parse, render, terms, terms_of
from kleinkram.contract.search import Facet, FacetsRead, FacetValue
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection
from kleinkram.server.filters.prepared import prepare
from kleinkram.server.search import chosen_values
from kleinkram.server.search.facet_queries import PLAIN_FACETS, facet_rows, parameters, variants
from kleinkram.server.search.planner import plan_search
from kleinkram.server.search.queries import ENLARGE_WORK_MEMORY

# Files that are looked at, and for how long; fewer where that takes too long.
_ATTEMPTS = ((2_000, 5_000), (200, 2_000))
_SET_TIMEOUT = text("SELECT set_config('statement_timeout', :milliseconds, true)")


async def get_facets(db: Connection, actor: Actor, *, query: str) -> FacetsRead:
    """Return the facets of a query, counted over files that this actor may see and no others.

    Where even a few files take too long to find there are none, and the answer is not whole.

    Raises:
        InvalidQuery: the query cannot be read; says which word, at which column.
    """
    matching = parse(query)
    filters = variants(actor, matching)
    plan, sample = await plan_search(db, actor, *filters)
    if plan.finds_nothing:
        return _to_facets(actor, matching, [], file_count=0, is_exact=True)
    common = tuple(sample.is_common(number) for number in range(len(filters)))
    for most, milliseconds in _ATTEMPTS:
        stmt, values = prepare(facet_rows, actor, matching, plan=plan, most=most, common=common)
        rows = await _within(db, stmt, values | parameters(matching), milliseconds=milliseconds)
        if rows is not None:
            file_count = next(row.file_count for row in rows if not row.facet)
            is_exact = file_count < most and not common[0]
            return _to_facets(actor, matching, rows, file_count=file_count, is_exact=is_exact)
    return FacetsRead(query=render(matching), file_count=0, is_exact=False, facets=[])


async def _within(
    db: Connection, stmt: CompoundSelect[Any], values: Mapping[str, object], *, milliseconds: int
) -> Sequence[Row[Any]] | None:
    """Return the rows of a statement, or None where it takes too long."""
    try:
        async with db.begin_nested():
            await db.execute(ENLARGE_WORK_MEMORY)
            await db.execute(_SET_TIMEOUT, {"milliseconds": str(milliseconds)})
            return (await db.execute(stmt, values)).all()
    except DBAPIError as error:
        if isinstance(error.orig, psycopg.errors.QueryCanceled):
            return None
        raise


def _to_facets(
    actor: Actor, matching: FileFilter, rows: Sequence[Row[Any]], *, file_count: int, is_exact: bool
) -> FacetsRead:
    facets = list(_facets(matching, rows, with_metadata=sees_whole_missions(actor)))
    return FacetsRead(query=render(matching), file_count=file_count, is_exact=is_exact, facets=facets)


def _facets(matching: FileFilter, rows: Sequence[Row[Any]], *, with_metadata: bool) -> Iterator[Facet]:
    fields = list(dict.fromkeys(row.facet for row in rows if row.facet.startswith(META)))
    fields += [META + field for field in chosen_values.fields(matching) if with_metadata and META + field not in fields]
    rows_by_facet: dict[str, list[Row[Any]]] = {name: [] for name in ["", *PLAIN_FACETS, *fields]}
    for row in rows:
        rows_by_facet[row.facet].append(row)
    query_terms = terms(matching)
    for name in [*PLAIN_FACETS, *fields]:
        values = [*_values(matching, query_terms, name, rows_by_facet[name])]
        if values:
            value_count = max([len(values), *(row.value_count for row in rows_by_facet[name])])
            yield Facet(name=name, values=values, value_count=value_count)


def _values(
    matching: FileFilter, query_terms: Mapping[str, list[str]], facet: str, rows: Sequence[Row[Any]]
) -> Iterator[FacetValue]:
    chosen = chosen_values.chosen(matching, facet)
    in_order = sorted(rows, key=lambda row: row.value, reverse=True)
    if facet != "month":
        in_order = sorted(rows, key=lambda row: (-row.file_count, row.value))
    shown = [
        (row.value, row.file_count, row.kind) for row in in_order if chosen_values.can_be_filtered(row.value, row.kind)
    ]
    # What is chosen stays to be taken back, whether or not it is among the first; globs are no values.
    is_found = {value for value in chosen if any(chosen_values.is_selected([value], facet, name) for name, *_ in shown)}
    shown += [(value, 0, "string") for value in chosen if value not in is_found and not is_glob(value)]
    # Only what is said of the facet differs from value to value.
    part = META if facet.startswith(META) else facet
    for value, file_count, kind in shown:
        is_selected = chosen_values.is_selected(chosen, facet, value)
        if is_selected:
            toggled = chosen_values.without_value(matching, facet, value)
        else:
            toggled = chosen_values.with_value(matching, facet, value, kind=kind)
        query = join_terms({**query_terms, part: terms_of(part, toggled)})
        yield FacetValue(value=value, file_count=file_count, is_selected=is_selected, query=query)
