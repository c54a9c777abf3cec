"""Many clients at once, reading and writing without pause; runs as its own process, with JSON arguments.

`python -m benchmarks.scale.crowd URL TOKEN CLIENTS SECONDS PROJECT_ID` prints one line: what each client got.
"""

import json
import random
import statistics
import sys
import threading
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field

import urllib3

from benchmarks.scale.places import seeded
from benchmarks.scale.requests import percentile

_FILES = 200
# Two of ten requests write.
_READS = (
    "projects?limit=50",
    "missions?sort=-created&limit=50",
    "missions?where=robot=husky-03&limit=50",
    "files?sort=-start&limit=50&topic=/imu/data",
    "search?query=harbour_001234",
)


@dataclass
class _Client:
    ms: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)


def main(url: str, token: str, clients: int, seconds: float, project_id: str) -> dict[str, object]:
    """Run the clients; return the number of responses, latencies, errors, and fairness."""
    crowd = [_Client() for _ in range(clients)]
    files = _files_there(url, token)
    until = time.monotonic() + seconds
    threads = [
        threading.Thread(target=_run, args=(client, number, url, token, until, project_id, files))
        for number, client in enumerate(crowd)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    counts = [len(client.ms) for client in crowd]
    every = [one for client in crowd for one in client.ms]
    return {
        "answers": len(every),
        "rps": len(every) / seconds,
        "p50_ms": statistics.median(every),
        "p99_ms": percentile(every, 99),
        "worst_ms": max(every),
        "errors": [error for client in crowd for error in client.errors],
        # The share of the client with the fewest responses, compared with the mean.
        "fairness": min(counts) / statistics.mean(counts),
    }


def _files_there(url: str, token: str) -> list[str]:
    """Return the ids of some files of all missions, outside the trash."""
    lot = random.Random(0)
    ids: list[str] = []
    with urllib3.PoolManager(retries=False, timeout=60) as pool:
        while len(ids) < _FILES:
            file_id = str(seeded(f"file{lot.randrange(1, 9000)}-1"))
            answer = pool.request("GET", f"{url}/api/v1/files/{file_id}", headers={"Authorization": f"Bearer {token}"})
            if answer.status not in {200, 404}:
                raise SystemExit(f"a file: {answer.status} {answer.data[:200].decode()}")
            ids += [file_id] if answer.status == 200 else []
    return ids


def _run(
    client: _Client, number: int, url: str, token: str, until: float, project_id: str, files: Sequence[str]
) -> None:
    lot = random.Random(number)
    headers = {"Authorization": f"Bearer {token}"}
    with urllib3.PoolManager(retries=False, timeout=60) as pool:
        while time.monotonic() < until:
            method, path, body = _next(lot, project_id, files)
            began = time.perf_counter()
            try:
                answer = pool.request(method, f"{url}/api/v1/{path}", headers=headers, json=body)
            except urllib3.exceptions.HTTPError as error:
                client.errors.append(f"{method} {path}: {error}")
                continue
            client.ms.append((time.perf_counter() - began) * 1000)
            if answer.status >= 300:
                client.errors.append(f"{method} {path}: {answer.status} {answer.data[:200].decode()}")


def _next(lot: random.Random, project_id: str, files: Sequence[str]) -> tuple[str, str, dict[str, object] | None]:
    kind = lot.randrange(10)
    if kind == 0:
        return "POST", f"projects/{project_id}/missions", {"name": f"crowd {uuid.uuid4()}", "metadata": {}}
    if kind == 1:
        return "PATCH", f"files/{lot.choice(files)}", {"labels": [f"seen {lot.randrange(9)}"]}
    if kind < 5:
        return "GET", f"files/{lot.choice(files)}/topics", None
    return "GET", lot.choice(_READS), None


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), sys.argv[5])))
