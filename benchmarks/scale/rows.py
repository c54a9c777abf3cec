"""All rows about size: `python -m benchmarks scale`, both sizes or one of KLEINKRAM_BENCH_SCALE=1,10."""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

import psycopg
import urllib3

from benchmarks.instance import api_process
from benchmarks.scale import seed
from benchmarks.scale.places import places, seeded
from benchmarks.scale.requests import list_rows, percentile, statements_of

Row = dict[str, object]
_CLIENTS = 50
_SECONDS = float(os.environ.get("KLEINKRAM_BENCH_CROWD_S", "60"))
_MOST_P99_MS, _LEAST_FAIR, _LEAST_GAIN = 1000, 0.5, 1.7
# One core each for two API workers, PostgreSQL and the clients.
_CORES_FOR_TWO = 4
# The gauges of the instance are read at most once a second.
_SCRAPES, _SCRAPE_EVERY_S, _MOST_SCRAPE_MS = 60, 1.1, 50
_DELETED = 100_000
_MEANWHILE = ("projects?limit=50", "missions?limit=50", "files?sort=-start&limit=50", "search?query=knee")
_FILL_MISSION = """
WITH made AS (
  INSERT INTO mission (id, project_id, name, name_key, metadata, created_by_id)
    VALUES (md5('swept')::uuid, md5('project1')::uuid, 'swept', 'swept', '{}', %(owner)s) RETURNING id
), bytes AS (
  INSERT INTO blob (id, store_id, key, size_bytes, sha256, md5, state, verified_at, uploaded_by_id, content)
    SELECT md5('swept' || n)::uuid, 'scale', 'swept' || n, 1000, sha256(('swept' || n)::bytea),
      decode(md5('swept' || n), 'hex'), 'verified', now(), %(owner)s, 'opaque'
    FROM generate_series(1, %(files)s::int) n RETURNING id, key
)
INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id)
  SELECT gen_random_uuid(), made.id, bytes.id, key, key, 'upload', %(owner)s FROM made, bytes
"""


def scale_rows(
    size: int, url: str, owner_token: str, environment: Mapping[str, str], *, owner_url: str
) -> Iterator[Row]:
    """Fill the instance to a size, and measure lists; `owner_url` is the database by the role that owns the tables."""
    database_url = environment["KLEINKRAM_DATABASE_URL"]
    began = time.perf_counter()
    seed.fill(database_url, seed.Size(size), owner_url=owner_url, say=lambda text: print(text, file=sys.stderr))
    label = size_label(size)
    requests = places(150 if size > 1 else 50)
    statements = statements_of(environment, owner_token, requests)
    tokens = {"admin": owner_token, "reader": seed.ALL}
    yield _filled_row(label, time.perf_counter() - began)
    yield from list_rows(label, url, tokens, statements, database_url, requests)


def scrape_row(size: int, port: int) -> Row:
    """Scrape the process that reports the whole instance, often enough for some scrapes to fall into slow queries."""
    times: list[float] = []
    with urllib3.PoolManager(retries=False, timeout=60) as pool:
        for number in range(_SCRAPES + 1):
            began = time.perf_counter()
            answer = pool.request("GET", f"http://127.0.0.1:{port}/metrics")
            if number > 0:  # the first one waits for all of them
                times.append((time.perf_counter() - began) * 1000)
            if answer.status != 200 or b"kleinkram_stored_bytes" not in answer.data:
                raise SystemExit("the process does not report the gauges of the instance")
            time.sleep(_SCRAPE_EVERY_S)
    series = sum(not line.startswith(b"#") for line in answer.data.splitlines())
    return {
        "what": f"{size_label(size)}: a scrape of the metrics, with the gauges of the instance",
        "measured": f"median {statistics.median(times):.0f} ms, p95 {percentile(times, 95):.0f} ms; {series} series",
        "bar": f"p95 <= {_MOST_SCRAPE_MS} ms",
        "met": percentile(times, 95) <= _MOST_SCRAPE_MS,
        "ms": times,
    }


def load_rows(size: int, url: str, owner_token: str, environment: Mapping[str, str]) -> Iterator[Row]:
    """Measure the filled instance while many clients read, write and delete."""
    label = size_label(size)
    yield _crowd_row(label, _crowd([url], owner_token))
    yield _two_row(label, environment, owner_token)
    yield _garbage_collection_row(label, url, owner_token, environment)


def size_label(size: int) -> str:
    """Return the suffix that names the size of a row."""
    return f"{200_000 * size:_} files".replace("_", " ")


def _filled_row(label: str, seconds: float) -> Row:
    return {"what": f"{label}: filled", "measured": f"{seconds:.0f} s", "bar": "", "met": True}


def _crowd(urls: list[str], token: str, *, clients: int = _CLIENTS, seconds: float = _SECONDS) -> dict[str, float]:
    """Run the clients, distributed over the addresses; return the totals."""
    project_id = str(seeded("project1"))
    share = [str(clients // len(urls)), str(seconds), project_id]
    commands = [[sys.executable, "-m", "benchmarks.scale.crowd", url, token, *share] for url in urls]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE) for command in commands]
    results = [json.loads(result.communicate()[0]) for result in running]
    if problems := [error for result in results for error in result["errors"]]:
        raise SystemExit(f"{len(problems)} requests failed, such as {problems[0]}")
    worst = ("p50_ms", "p99_ms", "worst_ms")
    worst_values = {name: max(float(result[name]) for result in results) for name in worst}
    return {
        **worst_values,
        "rps": sum(result["rps"] for result in results),
        "fairness": min(result["fairness"] for result in results),
    }


def _crowd_row(label: str, got: Mapping[str, float]) -> Row:
    return {
        "what": f"{label}: {_CLIENTS} clients reading and writing for {_SECONDS:.0f} s",
        "measured": f"no error, {got['rps']:.0f} rps, median {got['p50_ms']:.0f} ms, p99 {got['p99_ms']:.0f} ms; "
        f"who got least got {got['fairness']:.2f} of the mean",
        "bar": f"no error, p99 <= {_MOST_P99_MS} ms, >= {_LEAST_FAIR} of the mean",
        "met": got["p99_ms"] <= _MOST_P99_MS and got["fairness"] >= _LEAST_FAIR,
        **got,
    }


def _two_row(label: str, environment: Mapping[str, str], token: str) -> Row:
    """Two more API processes beside the instance's own: the same crowd at one of them, then at both."""
    seconds = min(_SECONDS, 20)
    with ExitStack() as stack:
        urls = [stack.enter_context(api_process(environment))[0] for _ in range(2)]
        one, two = _crowd(urls[:1], token, seconds=seconds)["rps"], _crowd(urls, token, seconds=seconds)["rps"]
    cores = os.cpu_count() or 1
    note = "" if cores >= _CORES_FOR_TWO else f"; this machine's {cores} cores are shared with database and clients"
    return {
        "what": f"{label}: two API workers against one",
        "measured": f"{two / one:.2f} x ({one:.0f} and {two:.0f} rps){note}",
        "bar": f">= {_LEAST_GAIN} x with {_CORES_FOR_TWO} cores or more",
        "met": cores < _CORES_FOR_TWO or two / one >= _LEAST_GAIN,
    }


def _garbage_collection_row(label: str, url: str, token: str, environment: Mapping[str, str]) -> Row:
    """Delete a mission of very many files and collect the garbage while one client sends requests."""
    times: list[float] = []
    with psycopg.connect(environment["KLEINKRAM_DATABASE_URL"], autocommit=True) as database:
        owner = database.execute("SELECT person_id FROM token WHERE name = 'local owner'").fetchone()
        database.execute("SET statement_timeout = 0")
        database.execute("DELETE FROM file WHERE mission_id = md5('swept')::uuid")
        database.execute("DELETE FROM mission WHERE id = md5('swept')::uuid")
        database.execute("DELETE FROM blob WHERE store_id = 'scale' AND key LIKE 'swept%'")
        database.execute(_FILL_MISSION, {"owner": owner and owner[0], "files": _DELETED})
        with urllib3.PoolManager(retries=False, timeout=60) as pool:
            headers = {"Authorization": f"Bearer {token}"}
            mission = f"{url}/api/v1/missions/{seeded('swept')}"
            began = time.perf_counter()
            answer = pool.request("DELETE", mission, headers=headers)
            if answer.status >= 300:
                raise SystemExit(f"{answer.status} {answer.data.decode()}")
            times.append((time.perf_counter() - began) * 1000)
            # Backdate the deletion, so that the trash is emptied at once.
            database.execute("UPDATE mission SET deleted_at = now() - interval '1 year' WHERE id = md5('swept')::uuid")
            collection = subprocess.Popen(
                [sys.executable, "-m", "benchmarks.scale.garbage_collection"],
                env={**environment},
                stdout=subprocess.PIPE,
            )
            while collection.poll() is None:
                for path in _MEANWHILE:
                    requests = time.perf_counter()
                    pool.request("GET", f"{url}/api/v1/{path}", headers=headers)
                    times.append((time.perf_counter() - requests) * 1000)
    seconds = time.perf_counter() - began
    return {
        "what": f"{label}: {_DELETED} files deleted and their rows swept in {seconds:.0f} s, asked meanwhile",
        "measured": f"{len(times)} answers, p99 {percentile(times, 99):.0f} ms, worst {max(times):.0f} ms",
        "bar": "none above 1000 ms",
        "met": max(times) <= 1000 and collection.returncode == 0,
    }


def small_files(folder: Path, count: int, size_bytes: int) -> Path:
    """Write many small files of random bytes, an hour old."""
    folder.mkdir(parents=True, exist_ok=True)
    hour_ago = time.time() - 3600
    for number in range(count):
        path = folder / f"{number:05}.bin"
        path.write_bytes(os.urandom(size_bytes))
        os.utime(path, (hour_ago, hour_ago))
    return folder
