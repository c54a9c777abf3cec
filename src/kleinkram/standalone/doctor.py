"""`klein doctor`: looks at an instance from outside and says what is wrong and how to mend it. Changes nothing."""

import http.client
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import TypedDict

from kleinkram.standalone import health
from kleinkram.standalone.binaries import locate_postgres, locate_weed
from kleinkram.standalone.data_dir import DataDir, is_held, load_ports, read_holder, refuse_newer
from kleinkram.standalone.errors import StandaloneError
from kleinkram.standalone.parts import last_complaint
from kleinkram.standalone.procs import listener, start_ticks

LOW_DISK_BYTES = 5 * 1024**3
LOW_DISK_SHARE = 0.02
WORST_SKEW_S = 60.0
"""S3 refuses signatures that are 15 minutes off; a minute is already a clock that nobody sets."""


@dataclass(frozen=True)
class Finding:
    """What one check found. `remedy` says what to do where it is not ok."""

    check: str
    ok: bool
    message: str
    remedy: str = ""


class Instance(TypedDict):
    """What the supervisor tells in instance.json, as far as it matters here."""

    url: str
    local_url: str
    store_url: str
    parts: dict[str, int | None]


def examine(root: Path) -> list[Finding]:
    """Run every check that makes sense for the state the instance is in; takes a few seconds at most."""
    data_dir = DataDir(root)
    findings = [*_programs(), *_folder(data_dir)]
    if not data_dir.lock_file.exists():
        return findings
    findings += [*_version(data_dir), *_token(data_dir), *_disk(data_dir)]
    if not is_held(data_dir):
        return [*findings, *_not_running(data_dir)]
    instance = _read_instance(data_dir)
    if instance is None:
        holder = read_holder(data_dir)
        return [
            *findings,
            Finding(
                "running",
                False,
                f"The supervisor{f' (pid {holder.pid})' if holder else ''} is not ready.",
                _logs(data_dir),
            ),
        ]
    return [*findings, *_running(data_dir, instance)]


def _running(data_dir: DataDir, instance: Instance) -> Iterator[Finding]:
    yield Finding("running", True, f"Kleinkram answers at {instance['url']}.")
    for name, pid in instance["parts"].items():
        alive = pid is not None and start_ticks(pid) is not None
        remedy = "" if alive else f"It is started again by itself; if that goes on, see {data_dir.log(name)}."
        why = "" if alive or name != "postgres" else last_complaint(data_dir.log(name))
        ill = f"Is not running: {why}." if why else "Is not running."
        yield Finding(f"part {name}", alive, f"Runs (pid {pid})." if alive else ill, remedy)
    yield from _api(data_dir, instance)
    yield from _store(data_dir, instance)


def _api(data_dir: DataDir, instance: Instance) -> Iterator[Finding]:
    url = instance["local_url"]
    try:
        answer = health.get(f"{url}/health/ready", timeout_s=10)
    except (OSError, http.client.HTTPException) as error:
        yield Finding("api", False, f"Does not answer at {url} ({error}).", f"See {data_dir.log('api')}.")
        return
    if answer.status == 200:
        yield Finding("api", True, "Database, store and migrations are all right.")
    else:
        said = answer.body.decode(errors="replace")[:500]
        yield Finding("api", False, f"Says that it is not ready: {said}", _logs(data_dir))
    yield from _clock("clock against the API", answer.date)


def _store(data_dir: DataDir, instance: Instance) -> Iterator[Finding]:
    """Ask the public address for the root without a signature: any S3 answer shows that clients reach it."""
    url = instance["store_url"]
    try:
        answer = health.get(f"{url}/", timeout_s=10)
    except (OSError, http.client.HTTPException) as error:
        yield Finding(
            "store reachable",
            False,
            f"The store's public address {url} cannot be reached from here ({error}): nobody can upload or download.",
            f"See {data_dir.log('store')}; if this machine is called otherwise from outside, start with --public-url.",
        )
        return
    reached = answer.status in (200, 403)
    remedy = "" if reached else "Something else answers there: choose another port with --s3-port."
    yield Finding("store reachable", reached, f"{url} answers with status {answer.status}.", remedy)
    yield from _clock("clock against the store", answer.date)


def _clock(check: str, date: str | None) -> Iterator[Finding]:
    if date is None:
        return
    skew_s = (datetime.now(timezone.utc) - parsedate_to_datetime(date)).total_seconds()
    ok = abs(skew_s) <= WORST_SKEW_S
    remedy = "" if ok else "Signatures carry the time: let both machines set their clocks (NTP)."
    yield Finding(check, ok, f"The clocks differ by {abs(skew_s):.0f} s.", remedy)


def _not_running(data_dir: DataDir) -> Iterator[Finding]:
    yield Finding("running", False, "Kleinkram does not run on this data directory.", "Start it with `klein up`.")
    for name, port in load_ports(data_dir).items():
        if name in ("api", "store") and (holder := listener(port)):
            yield Finding(
                f"port of the {name}",
                False,
                f"Port {port} is taken by {holder}.",
                "`klein up` will choose another; to keep it, end that program first.",
            )


def _programs() -> Iterator[Finding]:
    try:
        found = locate_postgres()
        yield Finding("PostgreSQL", True, f"Version {found.major} in {found.folder}.")
    except StandaloneError as error:
        yield Finding("PostgreSQL", False, str(error))
    try:
        yield Finding("weed", True, f"{locate_weed()}.")
    except StandaloneError as error:
        yield Finding("weed", False, str(error))


def _folder(data_dir: DataDir) -> Iterator[Finding]:
    root = data_dir.root
    if not data_dir.lock_file.exists():
        yield Finding("data directory", False, f"There is none at {root}.", "`klein up` makes it.")
    elif not os.access(root, os.R_OK | os.W_OK | os.X_OK):
        yield Finding("data directory", False, f"{root} cannot be written.", "Run as the user that owns it.")
    elif root.stat().st_mode & 0o066:
        yield Finding("data directory", False, f"{root} is open to other users.", f"Run `chmod 700 {root}`.")
    else:
        yield Finding("data directory", True, f"{root}.")


def _version(data_dir: DataDir) -> Iterator[Finding]:
    try:
        refuse_newer(data_dir)
    except StandaloneError as error:
        yield Finding("version", False, str(error))
        return
    yield Finding("version", True, "The data directory is of this version or an earlier one.")
    cluster = data_dir.postgres / "PG_VERSION"
    if cluster.exists() and (made_by := cluster.read_text().strip()) != str(_postgres_major()):
        yield Finding(
            "database version",
            False,
            f"The database was made by PostgreSQL {made_by}, the programs found are another version's.",
            f"Name a folder with programs of version {made_by} in KLEINKRAM_POSTGRES_BIN; to move on, make a backup by "
            "them (`klein backup create`), and restore it with this version into a new folder (`klein restore`).",
        )


def _postgres_major() -> int | None:
    try:
        return locate_postgres().major
    except StandaloneError:
        return None


def _token(data_dir: DataDir) -> Iterator[Finding]:
    token = data_dir.token_file
    if not token.exists():
        yield Finding("owner token", False, f"{token} is not there.", "`klein up` makes a new one.")
    elif token.stat().st_mode & 0o077:
        yield Finding("owner token", False, f"{token} can be read by others.", f"Run `chmod 600 {token}`.")
    else:
        yield Finding("owner token", True, "Readable by its owner only.")


def _disk(data_dir: DataDir) -> Iterator[Finding]:
    """Look at the disk of the data directory, and at that of the database where it has one of its own."""
    yield from _room("disk", data_dir.root)
    if data_dir.postgres.exists() and data_dir.postgres.stat().st_dev != data_dir.root.stat().st_dev:
        yield from _room("disk of the database", data_dir.postgres)


def _room(check: str, folder: Path) -> Iterator[Finding]:
    usage = shutil.disk_usage(folder)
    low = usage.free < LOW_DISK_BYTES or usage.free < usage.total * LOW_DISK_SHARE
    message = f"{usage.free / 1e9:.1f} GB free of {usage.total / 1e9:.0f} GB."
    remedy = (
        "Free some: below 1 % the store takes no more uploads, and without any the database stops until there is some. "
        "`klein stats` shows what is large."
    )
    yield Finding(check, not low, message, remedy if low else "")


def _read_instance(data_dir: DataDir) -> Instance | None:
    try:
        told: Instance = json.loads(data_dir.instance_file.read_text())
    except (OSError, ValueError):
        return None
    return told


def _logs(data_dir: DataDir) -> str:
    return f"See the logs in {data_dir.root / 'logs'}."
