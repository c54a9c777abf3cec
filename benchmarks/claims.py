"""Benchmark of claims: ten runners claim 10,000 runs concurrently; some are killed with their run.

The lease of a killed runner's run is set into the past, so that it expires at once instead of after a minute. Some
killed runners later report their run as done.
"""

import json
import os
import random
import threading
import time
import uuid
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import psycopg
import urllib3

_RUNS = int(os.environ.get("KLEINKRAM_BENCH_CLAIMS", "10000"))
_RUNNERS = 10
_KILLED_ONE_IN = 20
_ROOM = {"cores": 4, "memory_bytes": 10**11, "disk_bytes": 10**12, "gpus": 0}
_ABILITIES = {
    "executor": "docker",
    "isolation": "container",
    "images": True,
    "networks": ["none"],
    "gpus": False,
    "bounds_memory": True,
    "bounds_disk": True,
}
# Copies of one launched run: a claim reads the same columns as if each had been launched.
_FILL = """
INSERT INTO run (id, mission_id, version_id, parameters, network, cores, memory_bytes, disk_bytes, gpus, labels,
  needs_images, inputs_fingerprint, started_by_id, input_count, input_bytes)
SELECT gen_random_uuid(), mission_id, version_id, parameters, network, cores, memory_bytes, disk_bytes, gpus, labels,
  needs_images, inputs_fingerprint, started_by_id, input_count, input_bytes
FROM run, generate_series(1, %s) WHERE id = %s
"""
_EXPIRE_LEASES = (
    "UPDATE run SET lease_ends_at = now() - interval '1 second' WHERE id = %s AND attempt = %s AND ended_at IS NULL"
)


@dataclass
class _Lab:
    """State shared by the runners: the server, and counts of what happened."""

    url: str
    token: str
    database_url: str
    pool: urllib3.PoolManager
    begun: list[tuple[str, int]] = field(default_factory=list)
    refused: int = 0
    accepted: int = 0
    seconds: list[float] = field(default_factory=list)

    def post(self, path: str, body: object) -> tuple[int, Any]:
        """Send a request; return its status and body."""
        headers = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        answer = self.pool.request("POST", f"{self.url}/api/v1/{path}", body=json.dumps(body), headers=headers)
        return answer.status, json.loads(answer.data) if answer.data else None


def claims_row(url: str, owner_token: str, database_url: str, mission_id: str) -> dict[str, object]:
    """Execute all runs of a mission; return a row about claims that were given twice."""
    label = f"only-{uuid.uuid4().hex[:8]}"
    definition = {"name": "claims", "script": "print(1)", "resources": {"labels": [label]}}
    with urllib3.PoolManager(retries=False, timeout=60, maxsize=_RUNNERS) as pool:
        owner = _Lab(url, owner_token, database_url, pool)
        _, made = owner.post("tokens", {"name": "claims", "kind": "runner"})
        _, launched = owner.post("runs", {"mission_ids": [mission_id], "definition": definition, "force": True})
        template = launched["items"][0]["run"]["id"]
        with psycopg.connect(database_url, autocommit=True) as database:
            database.execute(_FILL, (_RUNS - 1, template))
        lab = _Lab(url, made["secret"], database_url, pool)
        started = time.perf_counter()
        threads = [threading.Thread(target=_play, args=(lab, label, seed)) for seed in range(_RUNNERS)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        took = time.perf_counter() - started
    with psycopg.connect(database_url) as database:
        question = "SELECT count(*), count(ended_at) FROM run WHERE labels = %s"
        count, ended = database.execute(question, ([label],)).fetchone() or (0, 0)
    twice = sum(1 for times in Counter(lab.begun).values() if times > 1)
    good = (twice, lab.accepted, count, ended) == (0, 0, _RUNS, _RUNS)
    lab.seconds.sort()
    return {
        "what": f"{_RUNS} claims by {_RUNNERS} runners, one in {_KILLED_ONE_IN} killed with its run",
        "measured": f"{twice} begun twice, {lab.accepted} late reports accepted, {ended} of {count} ended",
        "bar": "0, 0, all",
        "met": good,
        "also": f"{len(lab.begun) / took:.0f} claims/s, median {lab.seconds[len(lab.seconds) // 2] * 1000:.0f} ms; "
        f"{lab.refused} late reports refused",
    }


def _play(lab: _Lab, label: str, seed: int) -> None:
    """Act as a runner until no run is left; a killed runner is replaced by a new one."""
    rng = random.Random(seed)
    runner_id = _hello(lab, label)
    dead: list[dict[str, Any]] = []
    with psycopg.connect(lab.database_url, autocommit=True) as database:
        while True:
            started = time.perf_counter()
            _, answer = lab.post(f"runners/{runner_id}/claims", {"free": _ROOM, "wait_s": 0})
            lab.seconds.append(time.perf_counter() - started)
            claim = answer["run"]
            if claim is None:
                return
            lab.begun.append((claim["run_id"], claim["attempt"]))
            if rng.randrange(_KILLED_ONE_IN) == 0:
                database.execute(_EXPIRE_LEASES, (claim["run_id"], claim["attempt"]))
                dead.append(claim)
                runner_id = _hello(lab, label)
                continue
            _finish(lab, claim)
            if dead and rng.randrange(3) == 0:
                _report_late(lab, dead.pop())


def _hello(lab: _Lab, label: str) -> str:
    runner_id = str(uuid.uuid4())
    runner = {"id": runner_id, "name": "bench", "labels": [label], "capacity": _ROOM, "abilities": _ABILITIES}
    status, answer = lab.post("runners", {**runner, "default_image": "sha256:stock", "version": "0"})
    if status != 200:
        raise SystemExit(f"the server refused a runner: {answer}")
    return runner_id


def _finish(lab: _Lab, claim: dict[str, Any]) -> int:
    report = {"attempt": claim["attempt"], "reason": "done", "message": "", "exit_code": 0}
    status, _ = lab.post(f"runner/runs/{claim['run_id']}/finish", report)
    return status


def _report_late(lab: _Lab, claim: dict[str, Any]) -> None:
    """Report on a run whose lease has expired: the server must reject it once another attempt exists."""
    with psycopg.connect(lab.database_url, autocommit=True) as database:
        question = "SELECT attempt, runner_id IS NULL FROM run WHERE id = %s"
        attempt, is_free = database.execute(question, (claim["run_id"],)).fetchone() or (0, False)
    status = _finish(lab, claim)
    if status == 409:
        lab.refused += 1
    elif attempt != claim["attempt"] or is_free:
        lab.accepted += 1
