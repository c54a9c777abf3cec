"""Facets: how what a query finds divides, and the query with each part chosen. Bounded in files and in time."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import psycopg
from sqlalchemy import Row, func
from sqlalchemy.exc import DBAPIError

from kleinkram.contract.files import FileFilter
from kleinkram.contract.query import parse, render
from kleinkram.contract.query.keys import META, is_glob
from kleinkram.contract.query.rendering import in_words, terms, terms_of
from kleinkram.contract.searching import Facet, FacetsRead, FacetValue
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection
from kleinkram.server.filters import looking
from kleinkram.server.filters.asked import asked_alike
from kleinkram.server.filters.looking import let_join, look_ahead
from kleinkram.server.search import choosing
from kleinkram.server.search.facet_queries import PLAIN_FACETS, facet_rows, parameters, variants
from kleinkram.server.search.queries import room_to_count

# Files that are looked at, and for how long; fewer where that takes too long.
_ATTEMPTS = ((2_000, 5_000), (200, 2_000))


async def get_facets(db: Connection, actor: Actor, *, text: str) -> FacetsRead:
    """Return the facets of a query, of what this actor may see and nothing else.

    Where even a few files take too long to find there are none, and the answer is not whole.

    Raises:
        InvalidQuery: the query cannot be read; says which word, at which column.
    """
    matching = parse(text)
    if matching == FileFilter() and (found := await _of_everything(db, actor)):
        return found
    each = variants(actor, matching)
    actor, outlook = await look_ahead(db, actor, *each, FileFilter())
    if actor.looked.finds_nothing:
        return _to_facets(actor, matching, [], file_count=0, is_whole=True)
    many = tuple(outlook is not None and outlook.finds_many(number) for number in range(len(each)))
    if outlook is not None and not all(many):
        # Who sees few of all files sees few missions: these are best gone through one by one.
        await let_join(db, actor, freely=outlook.hits[len(each)] >= looking.MANY)
    for most, milliseconds in _ATTEMPTS:
        rows = await _within(db, actor, matching, many, most=most, milliseconds=milliseconds)
        if rows is not None:
            looked_at = _looked_at(rows)["found"]
            is_whole = looked_at < most and not many[0]
            return _to_facets(actor, matching, rows, file_count=looked_at, is_whole=is_whole)
    return FacetsRead(query=render(matching), file_count=0, is_whole=False, facets=[])


async def _of_everything(db: Connection, actor: Actor) -> FacetsRead | None:
    """Return the facets of all that is seen where that is many files; this is soon known with just these drawn."""
    if actor.few_mission_ids is not None:
        return None
    everything = FileFilter()
    await let_join(db, actor, freely=False)
    asked = asked_alike(actor, everything)
    stmt = facet_rows(asked, most=looking.DRAWN, many=(True,), drawn=looking.drawn_files())
    rows = (await db.execute(stmt, parameters(actor, everything))).all()
    looked_at = _looked_at(rows)
    if looked_at["drawn"] < looking.DRAWN or looked_at["found"] < looking.MANY:
        return None
    return _to_facets(actor, everything, rows, file_count=looked_at["found"], is_whole=False)


async def _within(
    db: Connection,
    actor: Actor,
    matching: FileFilter,
    many: Sequence[bool],
    *,
    most: int,
    milliseconds: int,
) -> Sequence[Row[Any]] | None:
    """Return the rows of all facets, or None where that takes too long."""
    stmt = facet_rows(asked_alike(actor, matching), most=most, many=many, drawn=looking.drawn_files())
    given = parameters(actor, matching)
    if all(many):
        # All files are drawn, and have just been looked through: that takes no time to be bounded.
        return (await db.execute(stmt, given)).all()
    try:
        async with db.begin_nested():
            timeout = func.set_config("statement_timeout", str(milliseconds), True)
            await db.execute(room_to_count().add_columns(timeout))
            return (await db.execute(stmt, given)).all()
    except DBAPIError as error:
        if isinstance(error.orig, psycopg.errors.QueryCanceled):
            return None
        raise


def _to_facets(
    actor: Actor, matching: FileFilter, rows: Sequence[Row[Any]], *, file_count: int, is_whole: bool
) -> FacetsRead:
    facets = list(_facets(matching, rows, with_metadata=sees_whole_missions(actor)))
    return FacetsRead(query=render(matching), file_count=file_count, is_whole=is_whole, facets=facets)


def _looked_at(rows: Sequence[Row[Any]]) -> dict[str, int]:
    return {row.value: row.file_count for row in rows if not row.facet}


def _facets(matching: FileFilter, rows: Sequence[Row[Any]], *, with_metadata: bool) -> Iterator[Facet]:
    fields = list(dict.fromkeys(row.facet for row in rows if row.facet.startswith(META)))
    fields += [META + field for field in choosing.fields(matching) if with_metadata and META + field not in fields]
    held: dict[str, list[Row[Any]]] = {name: [] for name in ["", *PLAIN_FACETS, *fields]}
    for row in rows:
        held[row.facet].append(row)
    said = terms(matching)
    for name in [*PLAIN_FACETS, *fields]:
        values = [*_values(matching, said, name, held[name])]
        if values:
            value_count = max([len(values), *(row.value_count for row in held[name])])
            yield Facet(name=name, values=values, value_count=value_count)


def _values(
    matching: FileFilter, said: Mapping[str, list[str]], facet: str, rows: Sequence[Row[Any]]
) -> Iterator[FacetValue]:
    chosen = choosing.chosen(matching, facet)
    in_order = sorted(rows, key=lambda row: row.value, reverse=True)
    if facet != "month":
        in_order = sorted(rows, key=lambda row: (-row.file_count, row.value))
    found = [(row.value, row.file_count, row.kind) for row in in_order if choosing.can_be_asked(row.value, row.kind)]
    # What is chosen stays to be taken back, whether or not it is among the first; globs are no values.
    is_found = {value for value in chosen if any(choosing.is_chosen([value], facet, each) for each, *_ in found)}
    found += [(value, 0, "string") for value in chosen if value not in is_found and not is_glob(value)]
    # Only what is said of the facet differs from value to value.
    part = META if facet.startswith(META) else facet
    for value, file_count, kind in found:
        is_chosen = choosing.is_chosen(chosen, facet, value)
        if is_chosen:
            toggled = choosing.without_value(matching, facet, value)
        else:
            toggled = choosing.with_value(matching, facet, value, kind=kind)
        query = in_words({**said, part: terms_of(part, toggled)})
        yield FacetValue(value=value, file_count=file_count, is_chosen=is_chosen, query=query)
