"""`klein doctor`: checks an instance from outside, and reports problems with their remedies. Changes nothing."""

import os
from collections.abc import Iterator
from datetime import datetime, timezone
from email.utils import parsedate_to_datetime
from pathlib import Path

from kleinkram.diagnostics import Diagnostic, check_clock, check_disk, judge, ok, problem
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


def examine(root: Path) -> list[Diagnostic]:
    """Run the checks that apply to the state of the instance; takes a few seconds at most."""
    data_dir = DataDir(root)
    results = [*_programs(), _folder(data_dir)]
    if not data_dir.lock_file.exists():
        return results
    results += [*_version(data_dir), _token(data_dir), *_disks(data_dir)]
    if not is_locked(data_dir):
        return [*results, *_not_running(data_dir)]
    info = load_runtime_info(data_dir)
    if info is None:
        holder = read_holder(data_dir)
        who = f"The supervisor{f' (pid {holder.pid})' if holder else ''}"
        return [*results, problem("running", f"{who} is not ready.", _logs(data_dir))]
    return [*results, *_running(data_dir, info)]


def _running(data_dir: DataDir, info: RuntimeInfo) -> Iterator[Diagnostic]:
    yield ok("running", f"Kleinkram answers at {info.url}.")
    for name, pid in info.services.items():
        if pid is not None and start_ticks(pid) is not None:
            yield ok(f"service {name}", f"Runs (pid {pid}).")
            continue
        reason = last_postgres_error(data_dir.log(name)) if name == "postgres" else ""
        remedy = f"It is restarted automatically; if this repeats, see {data_dir.log(name)}."
        yield problem(f"service {name}", f"Is not running{f': {reason}' if reason else ''}.", remedy)
    yield from _api(data_dir, info)
    yield from _store(data_dir, info)


def _api(data_dir: DataDir, info: RuntimeInfo) -> Iterator[Diagnostic]:
    url = info.local_url
    try:
        response = http_client.request("GET", f"{url}/health/ready", timeout_s=10)
    except http_client.RequestError as error:
        yield problem("api", f"Does not answer at {url} ({error}).", f"See {data_dir.log('api')}.")
        return
    if response.status == 200:
        yield ok("api", "Database, store and migrations are ready.")
    else:
        body = response.body.decode(errors="replace")[:500]
        yield problem("api", f"It is not ready: {body}", _logs(data_dir))
    yield from _clock("clock against the API", response.date)


def _store(data_dir: DataDir, info: RuntimeInfo) -> Iterator[Diagnostic]:
    """Request the public address without a signature: any S3 response shows that clients reach it."""
    url = info.store_url
    try:
        response = http_client.request("GET", f"{url}/", timeout_s=10)
    except http_client.RequestError as error:
        yield problem(
            "store reachable",
            f"The store's public address {url} cannot be reached from here ({error}): nobody can upload or download.",
            f"See {data_dir.log('store')}; if this machine has another name outside, start with --public-url.",
        )
        return
    remedy = "Something else answers there: choose another port with --s3-port."
    message = f"{url} answers with status {response.status}."
    yield judge("store reachable", response.status in (200, 403), message, remedy)
    yield from _clock("clock against the store", response.date)


def _clock(check: str, date: str | None) -> Iterator[Diagnostic]:
    if date is not None:
        yield check_clock(check, (datetime.now(timezone.utc) - parsedate_to_datetime(date)).total_seconds())


def _not_running(data_dir: DataDir) -> Iterator[Diagnostic]:
    yield problem("running", "Kleinkram is not running in this data directory.", "Start it with `klein up`.")
    for name, port in load_ports(data_dir).items():
        if name in ("api", "store") and (holder := port_listener(port)):
            remedy = "`klein up` will choose another; to keep it, end that program first."
            yield problem(f"port of the {name}", f"Port {port} is taken by {holder}.", remedy)


def _programs() -> Iterator[Diagnostic]:
    try:
        programs = locate_postgres()
        yield ok("PostgreSQL", f"Version {programs.major} in {programs.folder}.")
    except StandaloneError as error:
        yield problem("PostgreSQL", str(error))
    try:
        yield ok("weed", f"{locate_weed()}.")
    except StandaloneError as error:
        yield problem("weed", str(error))


def _folder(data_dir: DataDir) -> Diagnostic:
    check, root = "data directory", data_dir.root
    if not data_dir.lock_file.exists():
        return problem(check, f"There is none at {root}.", "`klein up` creates it.")
    if not os.access(root, os.R_OK | os.W_OK | os.X_OK):
        return problem(check, f"{root} cannot be written.", "Run as the user that owns it.")
    if root.stat().st_mode & 0o066:
        return problem(check, f"{root} is open to other users.", f"Run `chmod 700 {root}`.")
    return ok(check, f"{root}.")


def _version(data_dir: DataDir) -> Iterator[Diagnostic]:
    try:
        refuse_newer(data_dir)
    except StandaloneError as error:
        yield problem("version", str(error))
        return
    yield ok("version", "The data directory is of this version or an earlier one.")
    cluster = data_dir.postgres / "PG_VERSION"
    if cluster.exists() and (major := cluster.read_text().strip()) != str(_postgres_major()):
        yield problem(
            "database version",
            f"The database was made by PostgreSQL {major}, the programs found are another version's.",
            f"Name a folder with programs of version {major} in KLEINKRAM_POSTGRES_BIN; to move on, make a backup by "
            "them (`klein backup create`), and restore it with this version into a new folder (`klein restore`).",
        )


def _postgres_major() -> int | None:
    try:
        return locate_postgres().major
    except StandaloneError:
        return None


def _token(data_dir: DataDir) -> Diagnostic:
    check, token = "owner token", data_dir.token_file
    if not token.exists():
        return problem(check, f"{token} does not exist.", "`klein up` creates a new one.")
    if token.stat().st_mode & 0o077:
        return problem(check, f"{token} can be read by others.", f"Run `chmod 600 {token}`.")
    return ok(check, "Readable by its owner only.")


def _disks(data_dir: DataDir) -> Iterator[Diagnostic]:
    """Check the disk of the data directory, and that of the database if it is another one."""
    remedy = (
        "Free some: below 1 % the store takes no more uploads, and without any the database stops until there is some. "
        "`klein stats` shows what is large."
    )
    yield check_disk("disk", data_dir.root, remedy)
    if data_dir.postgres.exists() and data_dir.postgres.stat().st_dev != data_dir.root.stat().st_dev:
        yield check_disk("disk of the database", data_dir.postgres, remedy)


def _logs(data_dir: DataDir) -> str:
    return f"See the logs in {data_dir.root / 'logs'}."
