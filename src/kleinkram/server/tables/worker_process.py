"""One row for each worker process: when it was last alive. The queue's own table has a row for each lane instead."""

from sqlalchemy import Column, DateTime, Integer, Table, Text, Uuid, func

from kleinkram.server.tables.base import metadata

worker_process = Table(
    "worker_process",
    metadata,
    Column("id", Uuid, primary_key=True),
    Column("host", Text, nullable=False),
    Column("pid", Integer, nullable=False),
    Column("version", Text, nullable=False),
    Column("started_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("seen_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("ended_at", DateTime(timezone=True)),
)
