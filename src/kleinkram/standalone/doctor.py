"""`klein doctor`: checks an instance from outside, and reports problems with their remedies. Changes nothing."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from email.utils import parsedate_to_datetime
from pathlib import Path

from kleinkram.standalone import http_client
from kleinkram.standalone.data_dir import (
    DataDir,
    RuntimeInfo,
    is_locked,
    load_ports,
    load_runtime_info,
    read_holder,
    refuse_newer,
)
from kleinkram.standalone.errors import StandaloneError
from kleinkram.standalone.object_store import locate_weed
from kleinkram.standalone.postgres import locate_postgres
from kleinkram.standalone.processes import port_listener, start_ticks
from kleinkram.standalone.services import last_postgres_error

LOW_DISK_BYTES = 5 * 1024**3
LOW_DISK_SHARE = 0.02
WORST_SKEW_S = 60.0
"""S3 rejects signatures that are 15 minutes off; a synchronised clock differs by far less than a minute."""


@dataclass(frozen=True)
class DoctorFinding:
    """The result of one check. `remedy`: what to do where it is not ok."""

    check: str
    ok: bool
    message: str
    remedy: str = ""


def examine(root: Path) -> list[DoctorFinding]:
    """Run the checks that apply to the state of the instance; they take a few seconds at most."""
    data_dir = DataDir(root)
    findings = [*_programs(), *_folder(data_dir)]
    if not data_dir.lock_file.exists():
        return findings
    findings += [*_version(data_dir), *_token(data_dir), *_disk(data_dir)]
    if not is_locked(data_dir):
        return [*findings, *_not_running(data_dir)]
    info = load_runtime_info(data_dir)
    if info is None:
        holder = read_holder(data_dir)
        return [
            *findings,
            DoctorFinding(
                "running",
                False,
                f"The supervisor{f' (pid {holder.pid})' if holder else ''} is not ready.",
                _logs(data_dir),
            ),
        ]
    return [*findings, *_running(data_dir, info)]


def _running(data_dir: DataDir, info: RuntimeInfo) -> Iterator[DoctorFinding]:
    yield DoctorFinding("running", True, f"Kleinkram answers at {info.url}.")
    for name, pid in info.services.items():
        alive = pid is not None and start_ticks(pid) is not None
        remedy = "" if alive else f"It is restarted automatically; if this repeats, see {data_dir.log(name)}."
        why = "" if alive or name != "postgres" else last_postgres_error(data_dir.log(name))
        ill = f"Is not running: {why}." if why else "Is not running."
        yield DoctorFinding(f"service {name}", alive, f"Runs (pid {pid})." if alive else ill, remedy)
    yield from _api(data_dir, info)
    yield from _store(data_dir, info)


def _api(data_dir: DataDir, info: RuntimeInfo) -> Iterator[DoctorFinding]:
    url = info.local_url
    try:
        response = http_client.request("GET", f"{url}/health/ready", timeout_s=10)
    except http_client.RequestError as error:
        yield DoctorFinding("api", False, f"Does not answer at {url} ({error}).", f"See {data_dir.log('api')}.")
        return
    if response.status == 200:
        yield DoctorFinding("api", True, "Database, store and migrations are ready.")
    else:
        body = response.body.decode(errors="replace")[:500]
        yield DoctorFinding("api", False, f"It is not ready: {body}", _logs(data_dir))
    yield from _clock("clock against the API", response.date)


def _store(data_dir: DataDir, info: RuntimeInfo) -> Iterator[DoctorFinding]:
    """Request the public address without a signature: any S3 response shows that clients reach it."""
    url = info.store_url
    try:
        response = http_client.request("GET", f"{url}/", timeout_s=10)
    except http_client.RequestError as error:
        yield DoctorFinding(
            "store reachable",
            False,
            f"The store's public address {url} cannot be reached from here ({error}): nobody can upload or download.",
            f"See {data_dir.log('store')}; if this machine is called otherwise from outside, start with --public-url.",
        )
        return
    reached = response.status in (200, 403)
    remedy = "" if reached else "Something else answers there: choose another port with --s3-port."
    yield DoctorFinding("store reachable", reached, f"{url} answers with status {response.status}.", remedy)
    yield from _clock("clock against the store", response.date)


def _clock(check: str, date: str | None) -> Iterator[DoctorFinding]:
    if date is None:
        return
    skew_s = (datetime.now(timezone.utc) - parsedate_to_datetime(date)).total_seconds()
    ok = abs(skew_s) <= WORST_SKEW_S
    remedy = "" if ok else "Signatures contain the time: set the clocks of both machines by NTP."
    yield DoctorFinding(check, ok, f"The clocks differ by {abs(skew_s):.0f} s.", remedy)


def _not_running(data_dir: DataDir) -> Iterator[DoctorFinding]:
    yield DoctorFinding("running", False, "Kleinkram does not run on this data directory.", "Start it with `klein up`.")
    for name, port in load_ports(data_dir).items():
        if name in ("api", "store") and (holder := port_listener(port)):
            yield DoctorFinding(
                f"port of the {name}",
                False,
                f"Port {port} is taken by {holder}.",
                "`klein up` will choose another; to keep it, end that program first.",
            )


def _programs() -> Iterator[DoctorFinding]:
    try:
        programs = locate_postgres()
        yield DoctorFinding("PostgreSQL", True, f"Version {programs.major} in {programs.folder}.")
    except StandaloneError as error:
        yield DoctorFinding("PostgreSQL", False, str(error))
    try:
        yield DoctorFinding("weed", True, f"{locate_weed()}.")
    except StandaloneError as error:
        yield DoctorFinding("weed", False, str(error))


def _folder(data_dir: DataDir) -> Iterator[DoctorFinding]:
    root = data_dir.root
    if not data_dir.lock_file.exists():
        yield DoctorFinding("data directory", False, f"There is none at {root}.", "`klein up` creates it.")
    elif not os.access(root, os.R_OK | os.W_OK | os.X_OK):
        yield DoctorFinding("data directory", False, f"{root} cannot be written.", "Run as the user that owns it.")
    elif root.stat().st_mode & 0o066:
        yield DoctorFinding("data directory", False, f"{root} is open to other users.", f"Run `chmod 700 {root}`.")
    else:
        yield DoctorFinding("data directory", True, f"{root}.")


def _version(data_dir: DataDir) -> Iterator[DoctorFinding]:
    try:
        refuse_newer(data_dir)
    except StandaloneError as error:
        yield DoctorFinding("version", False, str(error))
        return
    yield DoctorFinding("version", True, "The data directory is of this version or an earlier one.")
    cluster = data_dir.postgres / "PG_VERSION"
    if cluster.exists() and (major := cluster.read_text().strip()) != str(_postgres_major()):
        yield DoctorFinding(
            "database version",
            False,
            f"The database was made by PostgreSQL {major}, the programs found are another version's.",
            f"Name a folder with programs of version {major} in KLEINKRAM_POSTGRES_BIN; to move on, make a backup by "
            "them (`klein backup create`), and restore it with this version into a new folder (`klein restore`).",
        )


def _postgres_major() -> int | None:
    try:
        return locate_postgres().major
    except StandaloneError:
        return None


def _token(data_dir: DataDir) -> Iterator[DoctorFinding]:
    token = data_dir.token_file
    if not token.exists():
        yield DoctorFinding("owner token", False, f"{token} does not exist.", "`klein up` creates a new one.")
    elif token.stat().st_mode & 0o077:
        yield DoctorFinding("owner token", False, f"{token} can be read by others.", f"Run `chmod 600 {token}`.")
    else:
        yield DoctorFinding("owner token", True, "Readable by its owner only.")


def _disk(data_dir: DataDir) -> Iterator[DoctorFinding]:
    """Check the disk of the data directory, and that of the database if it is another one."""
    yield from _free_space("disk", data_dir.root)
    if data_dir.postgres.exists() and data_dir.postgres.stat().st_dev != data_dir.root.stat().st_dev:
        yield from _free_space("disk of the database", data_dir.postgres)


def _free_space(check: str, folder: Path) -> Iterator[DoctorFinding]:
    usage = shutil.disk_usage(folder)
    low = usage.free < LOW_DISK_BYTES or usage.free < usage.total * LOW_DISK_SHARE
    message = f"{usage.free / 1e9:.1f} GB free of {usage.total / 1e9:.0f} GB."
    remedy = (
        "Free some: below 1 % the store takes no more uploads, and without any the database stops until there is some. "
        "`klein stats` shows what is large."
    )
    yield DoctorFinding(check, not low, message, remedy if low else "")


def _logs(data_dir: DataDir) -> str:
    return f"See the logs in {data_dir.root / 'logs'}."
