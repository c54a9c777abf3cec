"""Topics as they are listed, be it of one file or across many."""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row, Select

from kleinkram.contract.files import Density, TopicRead
from kleinkram.recordings.density import unpack
from kleinkram.server.db import by_name
from kleinkram.server.pagination import Order
from kleinkram.server.tables import file, topic


def topic_rows(stmt: Select[Any]) -> Select[Any]:
    """Return the topics of the files of a select that began with `visible_files`, as `to_topics` reads them."""
    columns = [column for column in topic.c if column.name not in {"id", "blob_id", "density"}]
    narrowed = stmt.with_only_columns(file.c.id.label("file_id"), *columns, maintain_column_froms=True)
    return narrowed.join(topic, topic.c.blob_id == file.c.blob_id)


TOPIC_ORDER = Order([topic.c.name, topic.c.id, file.c.id])


def to_topics(rows: Sequence[Row[Any]]) -> list[TopicRead]:
    """Return the topics that rows of `topic_rows` stand for, with their density where the rows have that too."""
    return [_to_topic(said) for said in by_name(rows)]


def _to_topic(said: dict[str, Any]) -> TopicRead:
    if said.get("density") is not None:
        known = unpack(said["density"])
        said["density"] = Density(start_ns=known.start_ns, bin_ns=known.bin_ns, counts=[*known.counts])
    return TopicRead.model_validate(said)
