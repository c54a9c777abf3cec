"""Topics as they are listed, be it of one file or across many."""

from typing import Any

from sqlalchemy import Row, Select

from kleinkram.contract.files import TopicRead
from kleinkram.contract.topics import Density
from kleinkram.recordings.density import unpack
from kleinkram.server.pages import Order
from kleinkram.server.tables import file, topic


def topic_rows(stmt: Select[Any]) -> Select[Any]:
    """Return the topics of the files of a select that began with `visible_files`, as `to_topic` reads them."""
    columns = [column for column in topic.c if column.name not in {"id", "blob_id", "density"}]
    narrowed = stmt.with_only_columns(file.c.id.label("file_id"), *columns, maintain_column_froms=True)
    return narrowed.join(topic, topic.c.blob_id == file.c.blob_id)


TOPIC_ORDER = Order([topic.c.name, topic.c.id, file.c.id])


def to_topic(row: Row[Any]) -> TopicRead:
    """Return the topic that a row of `topic_rows` stands for, with its density where the row has that too."""
    said: dict[str, Any] = {name: row._mapping[name] for name in TopicRead.model_fields if name != "density"}
    if row._mapping.get("density") is not None:
        known = unpack(row.density)
        said["density"] = Density(start_ns=known.start_ns, bin_ns=known.bin_ns, counts=[*known.counts])
    return TopicRead.model_validate(said)
