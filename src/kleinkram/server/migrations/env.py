"""Alembic's entry: one connection, one transaction, one migrator at a time."""

from collections.abc import Collection, Mapping

from alembic import context, op
from alembic.runtime.migration import MigrationContext, MigrationInfo
from alembic.script import Script
from sqlalchemy import Connection, ForeignKeyConstraint, create_engine, pool, text

from kleinkram.server.migrations.upgrading import LOCK
from kleinkram.server.tables import metadata

_FIRST_TO_SAY = "0027"


def _ours(thing: object, name: str | None, _kind: str, _reflected: bool, _compare_to: object) -> bool:
    # A key that leads to the queue's tables is as foreign to the described ones as these are.
    about = thing.referred_table.name if isinstance(thing, ForeignKeyConstraint) else name
    return not (about or "").startswith(("procrastinate", "idx_procrastinate"))


def _write_compatible_from(
    ctx: MigrationContext,
    step: MigrationInfo,
    heads: Collection[object],
    run_args: Mapping[str, object],
) -> None:
    """Write which programs work on the schema after a step: none before it, unless its revision says otherwise."""
    revision = step.up_revision
    if step.is_upgrade and isinstance(revision, Script) and revision.revision >= _FIRST_TO_SAY:
        oldest = getattr(revision.module, "compatible_from", revision.revision)
        op.execute(text("UPDATE alembic_version SET compatible_from = :oldest").bindparams(oldest=oldest))


def _migrate(connection: Connection) -> None:
    context.configure(
        connection=connection,
        target_metadata=metadata,
        include_object=_ours,
        compare_server_default=True,
        on_version_apply=_write_compatible_from,
    )
    with context.begin_transaction():
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
        context.run_migrations()


given = context.config.attributes.get("connection")
if given is not None:  # a caller's own, in whose transaction it happens
    _migrate(given)
else:
    engine = create_engine(context.config.attributes["url"], poolclass=pool.NullPool)
    with engine.connect() as own:
        _migrate(own)
    engine.dispose()
