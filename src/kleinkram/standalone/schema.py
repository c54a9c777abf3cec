"""Whether a database has already seen this version's migrations, found out without starting the server (0.9 s).

Believes only when both agree: what was noted after the last migration, and the revision in the database itself.
"""

import hashlib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import kleinkram
from kleinkram.standalone.data_dir import DataDir, write_private
from kleinkram.standalone.errors import PartFailed
from kleinkram.standalone.postgres import DATABASE, PostgresCluster, run_sql


def is_noted(data_dir: DataDir, cluster: PostgresCluster) -> bool:
    """Whether the database stands where these very migrations left it."""
    try:
        noted = data_dir.schema_file.read_text()
    except FileNotFoundError:
        return False
    return noted == _state(cluster)


def note(data_dir: DataDir, cluster: PostgresCluster) -> None:
    """Note where the migrations have left the database."""
    state = _state(cluster)
    if state is not None:
        write_private(data_dir.schema_file, state)


def _state(cluster: PostgresCluster) -> str | None:
    """Fingerprint of the installed migrations and the database's revision; None where it has none."""
    try:
        revision = run_sql(cluster, "SELECT version_num FROM alembic_version", database=DATABASE)
    except PartFailed:
        return None
    return f"{_fingerprint()} {revision}\n" if revision else None


def _fingerprint() -> str:
    digest = hashlib.sha256()
    for path in sorted((Path(kleinkram.__file__).parent / "server" / "migrations").rglob("*.*")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    try:
        digest.update(version("procrastinate").encode())  # the queue's tables are its own
    except PackageNotFoundError:
        digest.update(b"none")
    return digest.hexdigest()
