"""The rows about lists, searches and facets: times over HTTP, compared with the same SQL in a bare psycopg loop."""

import asyncio
import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any

import httpx
import psycopg
import urllib3
from sqlalchemy import event

from benchmarks.scale.places import Place

Row = dict[str, object]
# A statement as it was sent, and its values.
Statement = tuple[str, Any]
_TIMES, _WARM = int(os.environ.get("KLEINKRAM_BENCH_TIMES", "20")), 2
# Requests without a bar take long: sent once to warm up and once to measure.
_SELDOM, _SELDOM_WARM = 1, 1
_LEAST_SHARE, _MOST_BESIDE_ADMIN = 0.5, 1.3
# Enough clients to keep one worker busy during their round trips.
_CLIENTS, _SECONDS = 4, 2.0


def list_rows(
    label: str,
    url: str,
    tokens: Mapping[str, str],
    statements: Mapping[str, list[Statement]],
    database_url: str,
    places: list[Place],
) -> Iterator[Row]:
    """Send each request as `admin` and as `reader` in turn, with one client."""
    ratios: dict[str, float] = {}
    with urllib3.PoolManager(retries=False, timeout=120) as pool:
        for place in places:
            times = _ask_in_turn(pool, url, place, tokens)
            ratios[place.name] = statistics.median(times["reader"]) / statistics.median(times["admin"])
            if place.most_ms is None:
                yield _row_of(label, place, times["admin"])
                continue
            bare_ms = statistics.mean(_bare(statements[place.path], database_url))
            rps = _served(f"{url}/api/v1/{place.path}", tokens["admin"])
            yield _judged(label, place, times["admin"], bare_ms, rps)
    worst = max(ratios, key=lambda name: ratios[name])
    yield {
        "what": f"{label}: the same as an ordinary person with many grants, beside an admin",
        "measured": f"median {statistics.median(ratios.values()):.2f} x, worst {ratios[worst]:.2f} x ({worst})",
        "bar": f"<= {_MOST_BESIDE_ADMIN} x",
        "met": ratios[worst] <= _MOST_BESIDE_ADMIN,
        "ratios": ratios,
    }


def _row_of(label: str, place: Place, times: list[float]) -> Row:
    return {
        "what": f"{label}: {place.name}",
        "measured": f"median {statistics.median(times):.0f} ms, p95 {percentile(times, 95):.0f} ms",
        "bar": "",
        "met": True,
        "path": place.path,
        "ms": times,
    }


def _judged(label: str, place: Place, times: list[float], bare_ms: float, rps: float) -> Row:
    """Return the measurements, compared with a loop that only sends the same SQL."""
    row = _row_of(label, place, times)
    share, one = rps * bare_ms / 1000, bare_ms / statistics.mean(times)
    met = place.most_ms is not None and percentile(times, 95) <= place.most_ms and share >= _LEAST_SHARE
    return row | {
        "measured": f"{row['measured']}; {_CLIENTS} clients get {share:.2f} of a bare loop's rps, one gets {one:.2f}",
        "bar": f"p95 <= {place.most_ms} ms, the worker's rps >= {_LEAST_SHARE} of a bare loop's",
        "met": met,
        "bare_ms": bare_ms,
        "rps": rps,
    }


def _served(url: str, token: str) -> float:
    """Return the responses per second of one worker to several clients."""
    command = [sys.executable, "-m", "benchmarks.scale.several", url, token, str(_CLIENTS), str(_SECONDS)]
    return float(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)


def percentile(values: list[float], percent: float) -> float:
    """Return a percentile: the smallest value that this percentage of values does not exceed."""
    return sorted(values)[max(math.ceil(len(values) * percent / 100) - 1, 0)]


def _ask_in_turn(
    pool: urllib3.PoolManager, url: str, place: Place, tokens: Mapping[str, str]
) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {who: [] for who in tokens}
    warm, counted = (_WARM, _TIMES) if place.most_ms else (_SELDOM_WARM, _SELDOM)
    for number in range(warm + counted):
        for who in sorted(tokens, reverse=number % 2 == 0):
            began = time.perf_counter()
            answer = pool.request(
                "GET", f"{url}/api/v1/{place.path}", headers={"Authorization": f"Bearer {tokens[who]}"}
            )
            took = (time.perf_counter() - began) * 1000
            if answer.status >= 300:
                raise SystemExit(f"{place.path}: {answer.status} {answer.data.decode()}")
            if number >= warm:
                times[who].append(took)
    return times


def _bare(statements: list[Statement], database_url: str) -> list[float]:
    """Return the milliseconds that the statements of one request take by themselves, planned each time."""
    times = []
    with psycopg.connect(database_url, options="-c plan_cache_mode=force_custom_plan") as database:
        for number in range(_WARM + _TIMES):
            began = time.perf_counter()
            for statement, values in statements:
                # The text comes from the server itself.
                database.execute(statement, values).fetchall()
            database.commit()
            if number >= _WARM:
                times.append((time.perf_counter() - began) * 1000)
    return times


def statements_of(environment: Mapping[str, str], token: str, places: list[Place]) -> dict[str, list[Statement]]:
    """Return the SQL statements of each path, recorded in an app in this process."""
    os.environ.update({key: value for key, value in environment.items() if key.startswith("KLEINKRAM_")})
    os.environ.pop("KLEINKRAM_OWNER_TOKEN_FILE", None)
    return asyncio.run(_taken_down(token, places))


async def _taken_down(token: str, places: list[Place]) -> dict[str, list[Statement]]:
    from kleinkram.server.app import create_app
    from kleinkram.server.settings import Settings

    app = create_app(Settings())
    sent: list[Statement] = []

    def take_down(_connection: object, _cursor: object, statement: str, values: object, *_: object) -> None:
        if statement.lstrip().startswith(("SELECT", "WITH", "(")):
            sent.append((statement, values))

    timings = {}
    async with app.router.lifespan_context(app):
        event.listen(app.state.database.engine.sync_engine, "before_cursor_execute", take_down)
        asking = httpx.AsyncClient(
            transport=httpx.ASGITransport(app), base_url="http://bench", headers={"Authorization": f"Bearer {token}"}
        )
        async with asking as client:
            for place in places:
                sent.clear()
                (await client.get(f"/api/v1/{place.path}", timeout=120)).raise_for_status()
                timings[place.path] = list(sent)
    return timings
