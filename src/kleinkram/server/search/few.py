"""All that a search finds, where it is little: looked for once, and named in what is asked besides."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

from sqlalchemy import ARRAY, ColumnElement, Select, Text, cast, func, select

from kleinkram.contract.files import FileFilter, FileSort
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.looked import Found
from kleinkram.server.access.visible import visible_files
from kleinkram.server.access.whoever import KEPT
from kleinkram.server.db import Connection
from kleinkram.server.files import service as files
from kleinkram.server.filters.asked import Asked, asked_alike, values
from kleinkram.server.filters.files import narrow_files
from kleinkram.server.paging import in_order
from kleinkram.server.tables import file

# Files that a search finds and that are named in what it asks besides.
_FEW = 50_000


async def find_few(db: Connection, actor: Actor, matching: FileFilter, *, sort: FileSort, limit: int) -> Actor:
    """Return who asks, knowing all files that a filter finds, where these are few: then they are looked for once.

    The first of them are known in their order, `limit` and one more.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    asked = asked_alike(actor, matching)
    row = (await db.execute(_every(asked, sort, limit + 1, _FEW), values(actor, matching))).one()
    if row.file_count > _FEW:
        return actor
    return replace(actor, looked=replace(actor.looked, found=Found(**row._mapping)))


@lru_cache(maxsize=KEPT)
def _every(asked: Asked[FileFilter], sort: FileSort, first: int, most: int) -> Select[Any]:
    actor = replace(asked.actor, looked=replace(asked.actor.looked, goes_through_all=True))
    order = files.sorted_order(sort)
    keys = [column.label(f"key_{number}") for number, column in enumerate(order.columns)]
    found = narrow_files(actor, visible_files(actor), asked.matching)
    found = found.with_only_columns(file.c.mission_id, file.c.blob_id, *keys, maintain_column_froms=True)
    every = found.cte("found").prefix_with("MATERIALIZED")
    # Planned as if all were wanted: with a limit of its own, the database would count on meeting that many soon.
    some = select(every).limit(most + 1).cte("some").prefix_with("MATERIALIZED")
    file_id = some.c[keys[-1].name]
    ahead = in_order(select(file_id), [some.c[key.name] for key in keys], order).limit(first)
    return select(
        select(func.count()).select_from(some).scalar_subquery().label("file_count"),
        _written(select(file_id)).label("file_ids"),
        _written(select(some.c.mission_id).distinct()).label("mission_ids"),
        _written(select(some.c.blob_id)).label("blob_ids"),
        _written(ahead).label("first"),
    )


def _written(found: Select[Any]) -> ColumnElement[str]:
    return cast(func.array(found.scalar_subquery(), type_=ARRAY(Text)), Text)
