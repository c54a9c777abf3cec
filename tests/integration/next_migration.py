"""A migration after the latest one, as a later version would bring."""

from pathlib import Path
from types import ModuleType

import pytest
from alembic.config import Config

import kleinkram.server.migrations
from kleinkram.server.migrations import HEAD, alembic_config

NEXT = "0999"
_MIGRATION = f'''
import sqlalchemy as sa
from alembic import op

revision = "{NEXT}"
down_revision = "{HEAD}"


def upgrade() -> None:
    op.add_column("blob", sa.Column("added", sa.Text(), server_default="x", nullable=False))
    op.add_column("file", sa.Column("added", sa.Text()))
    op.execute("UPDATE file SET added = path")
    op.create_index("ix_file_added", "file", ["added"])
'''


def migration_text() -> str:
    """Return the text of the migration."""
    return _MIGRATION


def add_migration(module: ModuleType, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a module that reads `alembic_config` find one revision more."""
    (folder / "next.py").write_text(_MIGRATION)
    versions = Path(kleinkram.server.migrations.__file__).parent / "versions"

    def configure(url: str, serving_role: str) -> Config:
        config = alembic_config(url, serving_role)
        config.set_main_option("path_separator", "os")
        config.set_main_option("version_locations", f"{versions}:{folder}")
        return config

    monkeypatch.setattr(module, "alembic_config", configure)
