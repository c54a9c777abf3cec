"""What the start-up probe found that a store can do. One row a store, replaced at every start."""

from sqlalchemy import Boolean, Column, DateTime, Table, Text, func

from kleinkram.contract.uploads import ChecksumKind
from kleinkram.server.tables.base import metadata, one_of

store_probe = Table(
    "store_probe",
    metadata,
    Column("store_id", Text, primary_key=True),
    Column("checksum", Text, nullable=False),
    Column("writes_once", Boolean, nullable=False),
    Column("probed_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    one_of("checksum", ChecksumKind),
)
