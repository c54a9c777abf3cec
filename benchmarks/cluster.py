"""The rows about a cluster: what a run costs the server, lists beside a long queue, and a small project's turn.

A real API, worker, PostgreSQL and store. The cluster is simulated: one runner that speaks the protocol as the runner of
a login node does, with 500 jobs at a time that wait in a queue of its own, run for some seconds and do nothing.
"""

import os
import time
import uuid
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import psutil
import psycopg
import urllib3

from benchmarks.instance import endpoint_info, settle
from benchmarks.scale.requests import percentile
from benchmarks.simulated_cluster import SimulatedCluster
from kleinkram.client import connect
from kleinkram.contract.access import TokenKind
from kleinkram.contract.actions import OwnDefinition
from kleinkram.contract.runs import RunCreated

Row = dict[str, object]
_RUNS = int(os.environ.get("KLEINKRAM_BENCH_CLUSTER_RUNS", "2000"))
_QUEUED, _OF_SMALL = 10_000, 100
_AT_ONCE, _WITH_FILES = 500, 200
# Whole minutes, because periodic jobs begin with each.
_BASELINE_S = 120.0
_SERVER = ("api", "worker", "postgres")
_MOST_CPU_MS, _MOST_LIST_MS = 5.0, 50.0
# As at other scales: requests that are measured, after some that are not.
_LISTED, _WARM = 20, 2
# The home page is no list: it has no bar, here as at other scales.
_LISTS = ("runs?limit=100", "runs?active=true&limit=100&count=true", "missions?limit=100", "home")
# Copies of one launched run, each on a mission of its own.
_FILL = """
WITH copy AS (
  INSERT INTO mission (id, project_id, name, name_key, metadata, created_by_id)
  SELECT gen_random_uuid(), %(project)s, 'drive ' || n, 'drive ' || n, '{}', mission.created_by_id
  FROM mission, generate_series(1, %(count)s) n WHERE id = %(mission)s RETURNING id
)
INSERT INTO run (id, mission_id, launch_project_id, version_id, parameters, network, cores, memory_bytes, disk_bytes,
  gpus, labels, needs_images, inputs_fingerprint, started_by_id, input_count, input_bytes)
SELECT gen_random_uuid(), copy.id, %(project)s, version_id, parameters, network, cores, memory_bytes, disk_bytes, gpus,
  labels, needs_images, inputs_fingerprint, started_by_id, input_count, input_bytes
FROM copy, run WHERE run.id = %(run)s
"""
_FILL_INPUTS = """
INSERT INTO run_input (run_id, path, size_bytes, sha256, blob_id, file_id)
SELECT run.id, path, size_bytes, sha256, blob_id, file_id FROM run, run_input
WHERE run_input.run_id = %(run)s AND run.state = 'queued' AND run.id <> %(run)s
"""
# The number of filled tables that autovacuum has not analysed yet.
_UNSEEN = """
SELECT count(*) FROM pg_stat_user_tables
WHERE last_autoanalyze IS NULL AND relname IN ('mission', 'run', 'run_input')
"""
_WAITS = """
SELECT project.name, count(*), percentile_cont(0.5) WITHIN GROUP
  (ORDER BY extract(epoch FROM claimed_at - run.created_at))
FROM run JOIN project ON project.id = launch_project_id WHERE claimed_at IS NOT NULL AND labels = '{cluster}'
GROUP BY 1 ORDER BY 1
"""


def cluster_rows(url: str, owner_token: str, database_url: str, mission_id: str) -> Iterator[Row]:
    """Fill the queue, measure lists, and have a simulated cluster execute runs."""
    client = connect(url, owner_token)
    made = client.tokens.create("cluster", kind=TokenKind.runner)
    cluster = SimulatedCluster(url, made.secret, at_once=_AT_ONCE)
    cluster.register()
    definition = OwnDefinition.model_validate(
        {"name": "cluster", "script": "print(1)", "resources": {"labels": ["cluster"], "cores": 1}}
    )
    (launched,) = client.runs.launch(definition, [uuid.UUID(mission_id)], force=True)
    if not isinstance(launched, RunCreated):
        raise SystemExit(f"no run was created: {launched}")
    projects = {name: client.projects.create(name).id for name in ("large", "small")}
    with psycopg.connect(database_url, autocommit=True) as database:
        for name, count in (("large", _QUEUED - _OF_SMALL), ("small", _OF_SMALL)):
            values = {"project": projects[name], "count": count, "mission": mission_id, "run": launched.run.id}
            database.execute(_FILL, values)
        database.execute(_FILL_INPUTS, {"run": launched.run.id})
        # Rows that arrive over days are analysed meanwhile; the serving role may not run ANALYZE.
        while database.execute(_UNSEEN).fetchone() != (0,):
            time.sleep(1)
    client.runs.cancel(launched.run.id)
    settle()
    yield _list_row(url, owner_token)
    idle = _baseline()
    cost = _cost(cluster, _RUNS, idle)
    with psycopg.connect(database_url) as database:
        waits = {name: (count, float(median)) for name, count, median in database.execute(_WAITS)}
    yield _cost_row(cost, idle)
    yield _turn_row(waits)
    before = _cpu_s()
    cluster.run(_WITH_FILES, with_files=True)
    settle()
    with_files_ms = {name: (seconds - before[name]) / _WITH_FILES * 1000 for name, seconds in _cpu_s().items()}
    yield _files_row(with_files_ms)


def _list_row(url: str, token: str) -> Row:
    times: dict[str, float] = {}
    headers = {"Authorization": f"Bearer {token}"}
    with urllib3.PoolManager(retries=False, timeout=60) as pool:
        for path in _LISTS:
            taken = []
            for _ in range(_WARM + _LISTED):
                began = time.perf_counter()
                if pool.request("GET", f"{url}/api/v1/{path}", headers=headers).status != 200:
                    raise SystemExit(f"{path} was not answered")
                taken.append((time.perf_counter() - began) * 1000)
            times[path.partition("&limit")[0]] = percentile(taken[_WARM:], 95)
    return {
        "what": f"lists with {_QUEUED:,} queued runs, p95",
        "measured": ", ".join(f"{path} {ms:.0f} ms" for path, ms in times.items()),
        "bar": f"<= {_MOST_LIST_MS:.0f} ms; home has none",
        "met": max(ms for path, ms in times.items() if path != "home") <= _MOST_LIST_MS,
        "p95_ms": times,
    }


class _Baseline(NamedTuple):
    """What the parts of the server use without the runs, in cores."""

    cores: Mapping[str, float]

    @property
    def share(self) -> float:
        """What all of them use together."""
        return sum(self.cores[name] for name in _SERVER)


class _Cost(NamedTuple):
    """What a run costs the parts of the server beyond the baseline, in milliseconds of a core; and its requests."""

    ms: Mapping[str, float]
    requests: float
    took_s: float

    @property
    def server_ms(self) -> float:
        """What all of them use together."""
        return sum(self.ms[name] for name in _SERVER)

    @property
    def parts(self) -> str:
        """What each part uses."""
        return ", ".join(f"{name} {ms:.1f}" for name, ms in self.ms.items())


def _baseline() -> _Baseline:
    before = _cpu_s()
    time.sleep(_BASELINE_S)
    return _Baseline({name: (seconds - before[name]) / _BASELINE_S for name, seconds in _cpu_s().items()})


def _cost(cluster: SimulatedCluster, runs: int, baseline: _Baseline) -> _Cost:
    before, requests, started = _cpu_s(), cluster.requests, time.perf_counter()
    cluster.run(runs)
    settle()
    took_s = time.perf_counter() - started
    used_s = {name: seconds - before[name] - baseline.cores[name] * took_s for name, seconds in _cpu_s().items()}
    ms = {name: seconds / runs * 1000 for name, seconds in used_s.items()}
    return _Cost(ms, (cluster.requests - requests) / runs, took_s)


def _cost_row(cost: _Cost, idle: _Baseline) -> Row:
    return {
        "what": f"{_RUNS:,} runs of a simulated cluster, {_AT_ONCE} at a time, {_QUEUED:,} queued: cost on the server",
        "measured": f"{cost.server_ms:.1f} ms of a core per run ({cost.parts})",
        "bar": f"<= {_MOST_CPU_MS:.0f} ms",
        "met": cost.server_ms <= _MOST_CPU_MS,
        "also": f"{cost.requests:.2f} requests per run, {cost.took_s:.0f} s; beyond the {idle.share:.1%} of a core "
        "of the idle server with its queue",
        "ms": dict(cost.ms),
    }


def _files_row(ms: Mapping[str, float]) -> Row:
    server_ms = sum(ms[name] for name in _SERVER)
    parts = ", ".join(f"{name} {ms[name]:.1f}" for name in ms)
    return {
        "what": f"{_WITH_FILES} such runs that leave a file each, which is stored and verified",
        "measured": f"{server_ms:.1f} ms of a core per run ({parts})",
        "bar": "none: for comparison",
        "met": True,
        "ms": dict(ms),
    }


def _turn_row(waits: Mapping[str, tuple[int, float]]) -> Row:
    count, small_s = waits["small"]
    return {
        "what": f"a project with {_OF_SMALL} runs queued behind {_QUEUED - _OF_SMALL:,} of another",
        "measured": f"{count} started, after {small_s:.1f} s (median); "
        f"{waits['large'][0]} of the large one, after {waits['large'][1]:.1f} s",
        "bar": "all of the small one, no later than the large one's",
        "met": count == _OF_SMALL and small_s <= waits["large"][1] + 1,
    }


def _cpu_s() -> dict[str, float]:
    """Return the CPU time that each part of the instance has used, with the processes that it ended."""
    used = {}
    for name, pid in endpoint_info()["services"].items():
        process = psutil.Process(pid)
        used[name] = 0.0
        for one in (process, *process.children(recursive=True)):
            times = one.cpu_times()
            used[name] += times.user + times.system + times.children_user + times.children_system
    return used
