"""The row about traces: what they cost the API, in requests per second of one process that is busy.

Two API processes beside the instance's own, one with traces and one without, answer the same requests in turns. A
process that is busy answers as many requests per second as its CPU time per request allows, so that is measured: other
processes of a small machine, and the collector, do not count.
"""

import json
import statistics
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import psutil
import urllib3

from benchmarks.instance import api_process

Row = dict[str, object]
_MISSIONS = 100
# Short turns, many of them: the speed of a virtual machine's processor drifts by a tenth within seconds.
_ROUNDS, _TURNS, _REQUESTS = 10, 12, 40
_MOST_SHARE = 0.03
# Reads of a page, which most requests are, and of one object, which are the cheapest.
_PATHS = ("missions?limit=50", "projects/{project_id}", "missions/{mission_id}", "files?limit=50")


def traces_row(environment: Mapping[str, str], token: str) -> Row:
    """Measure the same requests with and without traces."""
    with (
        _collector() as (endpoint, received),
        api_process(environment) as (url, bare),
        api_process({**environment, "OTEL_EXPORTER_OTLP_ENDPOINT": endpoint}) as (traced_url, traced),
        urllib3.PoolManager(retries=False, timeout=60) as pool,
    ):
        paths = _filled(pool, url, token)
        shares = []
        sides = [(url, bare), (traced_url, traced)]
        for number in range(_ROUNDS + 1):
            cpu_s = {url: 0.0, traced_url: 0.0}
            for turn in range(_TURNS):
                for side, process in sides[::-1] if turn % 2 else sides:
                    cpu_s[side] += _cpu_s(pool, side, process, paths, token)
            if number > 0:  # the first round warms up
                shares.append(1 - cpu_s[url] / cpu_s[traced_url])
    if not received:
        raise SystemExit("the collector got no spans")
    share = statistics.median(shares)
    return {
        "what": "requests per second that traces cost",
        "measured": f"{share:.1%} (from {min(shares):.1%} to {max(shares):.1%} of {_ROUNDS} rounds)",
        "bar": f"<= {_MOST_SHARE:.0%}",
        "met": share <= _MOST_SHARE,
        "shares": shares,
    }


def _filled(pool: urllib3.PoolManager, url: str, token: str) -> list[str]:
    """Create missions, and return the paths to request."""
    headers = {"Authorization": f"Bearer {token}"}

    def create(path: str, name: str) -> str:
        answer = pool.request("POST", f"{url}/api/v1/{path}", json={"name": name}, headers=headers)
        if answer.status != 201:
            raise SystemExit(f"{path}: {answer.status} {answer.data[:200].decode()}")
        return str(json.loads(answer.data)["id"])

    project_id = create("projects", "traces")
    mission_ids = [create(f"projects/{project_id}/missions", f"mission {number}") for number in range(_MISSIONS)]
    return [path.format(project_id=project_id, mission_id=mission_ids[0]) for path in _PATHS]


def _cpu_s(pool: urllib3.PoolManager, url: str, process: psutil.Process, paths: list[str], token: str) -> float:
    """Return the CPU time that a process takes for the requests, its export of spans included."""
    headers = {"Authorization": f"Bearer {token}"}
    before = process.cpu_times()
    for number in range(_REQUESTS):
        answer = pool.request("GET", f"{url}/api/v1/{paths[number % len(paths)]}", headers=headers)
        if answer.status != 200:
            raise SystemExit(f"{answer.status} {answer.data[:200].decode()}")
    after = process.cpu_times()
    return float(after.user + after.system - before.user - before.system)


@contextmanager
def _collector() -> Iterator[tuple[str, list[int]]]:
    """Receive spans; yields the endpoint, and the sizes of what was received."""
    received: list[int] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            received.append(len(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", received
    finally:
        server.shutdown()
        server.server_close()
