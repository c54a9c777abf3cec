"""Uploading: a plan goes in, a report comes out. Run it again, after whatever happened, and only the rest is sent."""

import threading
import uuid

from kleinkram.client._client import Client
from kleinkram.client.transfer._uploader import Uploader
from kleinkram.client.transfer.outcome import TransferReport, TransferResult
from kleinkram.client.transfer.pace import Pace, check_limits
from kleinkram.client.transfer.plan import UploadPlan
from kleinkram.client.transfer.progress import Unwatched, Watcher

CONNECTIONS = 4


def upload(
    client: Client,
    mission_id: uuid.UUID,
    plan: UploadPlan,
    *,
    connections: int = CONNECTIONS,
    bytes_per_s: float | None = None,
    watcher: Watcher | None = None,
) -> TransferReport:
    """Upload the planned files into a mission and return how each ended.

    One refused file does not stop the others. Memory does not grow with the size of files. A server or store that is
    away for up to some minutes is waited for.

    Raises:
        ServerUnreachable, StoreUnreachable: one of them stayed away.
        KleinkramError: something else that concerns all files, such as a mission that was deleted.
    """
    check_limits(connections, bytes_per_s)
    watcher = watcher or Unwatched()
    results: dict[str, TransferResult] = {}
    lock = threading.Lock()

    def ended(result: TransferResult) -> None:
        with lock:
            results[result.path] = result
        watcher.ended(result.path, result.outcome.value, str(result.error) if result.error else None)

    watcher.began(len(plan.files), plan.size_bytes)
    uploader = Uploader(
        client.uploads, client.endpoint.url, mission_id, pace=Pace(bytes_per_s), watcher=watcher, ended=ended
    )
    link = uploader.run(plan.files, connections)
    return TransferReport([results[file.path] for file in plan.files], plan.left_out, link)
