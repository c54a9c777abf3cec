"""Downloading: a plan goes in, a report comes out. Run it again, after whatever happened: only the rest is fetched."""

import os
import shutil
import threading
import uuid

from kleinkram.client._client import Client
from kleinkram.client.errors import DestinationRefused, DiskFull
from kleinkram.client.transfer._downloader import Check, Downloader, Links
from kleinkram.client.transfer._place import PART_SUFFIX, part_file
from kleinkram.client.transfer.destination import DownloadPlan, Target
from kleinkram.client.transfer.outcome import TransferReport, TransferResult
from kleinkram.client.transfer.pace import Pace, check_limits
from kleinkram.client.transfer.progress import Unwatched, Watcher

CONNECTIONS = 4


def download(
    client: Client,
    plan: DownloadPlan,
    *,
    overwrite: bool = False,
    connections: int = CONNECTIONS,
    bytes_per_s: float | None = None,
    watcher: Watcher | None = None,
) -> TransferReport:
    """Download the planned files and return how each ended.

    Every file is verified against the server's checksum, then appears under its name at once and whole; until then it
    is `NAME.klein-part`. A file that is here already is left as it is: the same, or refused unless `overwrite`.

    Raises:
        DiskFull: there is no room for all of it.
        ServerUnreachable, StoreUnreachable: one of them stayed away.
    """
    return fetch(
        lambda file_ids: client.files.links(file_ids).items,
        client.endpoint.url,
        plan,
        overwrite=overwrite,
        connections=connections,
        bytes_per_s=bytes_per_s,
        watcher=watcher,
        check=client.files.verify,
    )


def fetch(
    links: Links,
    server: str,
    plan: DownloadPlan,
    *,
    overwrite: bool = False,
    connections: int = CONNECTIONS,
    bytes_per_s: float | None = None,
    watcher: Watcher | None = None,
    check: Check | None = None,
) -> TransferReport:
    """Download what is planned from where `links`, asked of a `server`, says it is; all else is as in `download`.

    `check` has the server read a file that the store does not return.
    """
    check_limits(connections, bytes_per_s)
    watcher = watcher or Unwatched()
    results: dict[uuid.UUID | None, TransferResult] = {}
    lock = threading.Lock()

    def ended(result: TransferResult) -> None:
        with lock:
            results[result.file_id] = result
        watcher.ended(result.path, result.outcome.value, str(result.error) if result.error else None)

    if plan.targets:
        _check_room(plan)
    watcher.began(len(plan.targets), plan.size_bytes)
    downloader = Downloader(
        links, server, pace=Pace(bytes_per_s), watcher=watcher, overwrite=overwrite, ended=ended, check=check
    )
    link = downloader.run(plan.targets, connections)
    return TransferReport([results[target.file.id] for target in plan.targets], plan.left_out, link)


def _check_room(plan: DownloadPlan) -> None:
    dest = plan.targets[0].dest
    try:
        dest.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(dest).free
    except OSError as error:
        raise DestinationRefused(path=os.fspath(dest), reason=error.strerror or str(error)) from None
    needed = sum(_needed(target) for target in plan.targets)
    if needed > free:
        raise DiskFull(path=os.fspath(dest), reason=f"{needed} bytes are needed and {free} are free")


def _needed(target: Target) -> int:
    """Return how much more room a file takes; what an earlier run left takes its own already."""
    if target.local.exists():
        return 0
    try:
        return max(0, target.file.size_bytes - part_file(target.local, PART_SUFFIX).stat().st_blocks * 512)
    except OSError:
        return target.file.size_bytes
