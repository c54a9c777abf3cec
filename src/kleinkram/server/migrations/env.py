"""Alembic's entry point: one connection, one transaction, one migrator at a time."""

from collections.abc import Collection, Mapping

from alembic import context, op
from alembic.runtime.migration import MigrationContext, MigrationInfo
from alembic.script import Script
from sqlalchemy import Connection, ForeignKeyConstraint, create_engine, pool, text

from kleinkram.server.migrations.migrate import LOCK
from kleinkram.server.tables import metadata


def _is_ours(item: object, name: str | None, _kind: str, _reflected: bool, _compare_to: object) -> bool:
    """Leave out the job queue's tables, their indexes and foreign keys to them."""
    table = item.referred_table.name if isinstance(item, ForeignKeyConstraint) else name
    return not (table or "").startswith(("procrastinate", "idx_procrastinate", "ix_procrastinate"))


def _write_compatible_from(
    ctx: MigrationContext,
    step: MigrationInfo,
    heads: Collection[object],
    run_args: Mapping[str, object],
) -> None:
    """Write the oldest program that works on the new schema: the revision's own, unless its module names another."""
    revision = step.up_revision
    if step.is_upgrade and isinstance(revision, Script):
        oldest = getattr(revision.module, "compatible_from", revision.revision)
        op.execute(text("UPDATE alembic_version SET compatible_from = :oldest").bindparams(oldest=oldest))


def _migrate(connection: Connection) -> None:
    context.configure(
        connection=connection,
        target_metadata=metadata,
        include_object=_is_ours,
        compare_server_default=True,
        on_version_apply=_write_compatible_from,
    )
    with context.begin_transaction():
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
        context.run_migrations()


callers_connection = context.config.attributes.get("connection")
if callers_connection is not None:  # with a transaction of the caller
    _migrate(callers_connection)
else:
    engine = create_engine(context.config.attributes["url"], poolclass=pool.NullPool)
    with engine.connect() as new_connection:
        _migrate(new_connection)
    engine.dispose()
