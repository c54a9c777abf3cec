"""Runners: machines that ask for runs."""

from sqlalchemy import ARRAY, Column, DateTime, ForeignKey, Table, Text, Uuid, text
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.server.tables.base import created_at_column, id_column, metadata

runner = Table(
    "runner",
    metadata,
    id_column(),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False, index=True),
    # The token with which it last said hello. No foreign key: tokens of runs refer to runs, and these to runners.
    Column("token_id", Uuid),
    Column("name", Text, nullable=False),
    Column("labels", ARRAY(Text), nullable=False, server_default="{}"),
    Column("capacity", JSONB, nullable=False),
    Column("abilities", JSONB, nullable=False),
    Column("default_image", Text),
    Column("version", Text, nullable=False),
    created_at_column(),
    Column("last_seen_at", DateTime(timezone=True), nullable=False, server_default=text("now()")),
)
