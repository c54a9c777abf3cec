"""The rows about runs: start and end latency, many runs on few slots, continuous logs, cached inputs.

A runner of its own, with an engine of its own where Docker is installed, else with processes; says which.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import urllib3
from tests.integration.runner.engines import IMAGE, PROGRAMS, Dockerd, python_root
from tests.requirements import path_of

from kleinkram.contract.runs import RunCreated, RunsCreated

_TIMES = int(os.environ.get("KLEINKRAM_BENCH_PAIRS", "6")) * 2
_MANY = int(os.environ.get("KLEINKRAM_BENCH_RUNS", "200"))
_MB = 10**6
_LOG_MB = 60
_LOG_LINE_BYTES = 100
_TRIVIAL = "print('hello'); open('/out/left.txt', 'w').write('left')"
_WRITING = f"""
import sys, time
began, line = time.monotonic(), 'x' * {_LOG_LINE_BYTES - 11}
for number in range({_LOG_MB * _MB // _LOG_LINE_BYTES}):
    sys.stdout.write(f'{{number:09}} {{line}}\\n')
    if number % 10000 == 9999:
        sys.stdout.flush()
        time.sleep(max(0, began + (number + 1) * {_LOG_LINE_BYTES} / 10e6 - time.monotonic()))
"""


@dataclass
class _Lab:
    url: str
    token: str
    pool: urllib3.PoolManager
    # Null where runs are processes.
    docker: Dockerd | None

    def ask(self, method: str, path: str, body: object = None) -> Any:
        headers = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body)
        answer = self.pool.request(method, f"{self.url}/api/v1/{path}", body=data, headers=headers)
        if answer.status >= 300:
            raise SystemExit(f"{path}: {answer.status} {answer.data.decode()}")
        return json.loads(answer.data) if answer.data else None

    def launch(self, mission_id: str, text: str, **resources: Any) -> str:
        """Launch a run; return its id."""
        what: dict[str, Any] = {"script": text}
        if self.docker is not None:
            what = {"image": IMAGE, "command": ["/usr/bin/python3", "-c", text]}
        needs = {"cores": 1, "memory": "200MB", "disk": "500MB", "labels": ["bench"], **resources}
        launch = {"mission_ids": [mission_id], "definition": {"name": "bench", "resources": needs, **what}}
        (item,) = RunsCreated.model_validate(self.ask("POST", "runs", {**launch, "force": True})).items
        if not isinstance(item, RunCreated):
            raise SystemExit(f"no run was created: {item}")
        return str(item.run.id)

    def end_of(self, run_id: str, *, within_s: float = 120) -> Any:
        """Wait until a run is over, and return it."""
        until = time.monotonic() + within_s
        while time.monotonic() < until:
            run = self.ask("GET", f"runs/{run_id}")
            if run["ended_at"] is not None:
                return run
            time.sleep(0.1)
        raise SystemExit(f"the run {run_id} did not end")


@contextmanager
def _lab(url: str, owner_token: str, folder: Path) -> Iterator[_Lab]:
    with ExitStack() as stack:
        pool = stack.enter_context(urllib3.PoolManager(retries=False, timeout=60, maxsize=4))
        docker = None
        if all(map(path_of, PROGRAMS)) and os.getuid() == 0:
            # Not in the benchmark's folder: the engine leaves mounts there, and a socket's path must be short.
            place = stack.enter_context(tempfile.TemporaryDirectory(prefix="klein-docker-", ignore_cleanup_errors=True))
            docker = Dockerd(Path(place))
            stack.callback(docker.end)
            docker.start()
            docker.load(IMAGE, root=python_root())
        lab = _Lab(url, owner_token, pool, docker)
        made = lab.ask("POST", "tokens", {"name": f"bench {uuid.uuid4().hex[:4]}", "kind": "runner"})
        options = {
            "url": url,
            "data_dir": str(folder / "runner"),
            "name": "bench",
            "labels": ["bench"],
            "cores": 2,
            "executor": "process" if docker is None else "docker",
        }
        environment = {**os.environ, "KLEINKRAM_RUNNER_TOKEN": made["secret"]}
        if docker is not None:
            environment["DOCKER_HOST"] = f"unix://{docker.socket}"
        with (folder / "runner.log").open("wb") as log:
            command = [sys.executable, "-m", "kleinkram.runner", json.dumps(options)]
            runner = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        stack.callback(_end, runner)
        yield lab


def _end(runner: "subprocess.Popen[bytes]") -> None:
    runner.terminate()
    runner.wait(timeout=30)


def run_rows(url: str, owner_token: str, folder: Path, upload: Callable[[str, Path], str]) -> list[dict[str, object]]:
    """Measure all rows; `upload` uploads a file to a new mission and returns the mission's id."""
    folder.mkdir(parents=True, exist_ok=True)
    small = folder / "small.bin"
    small.write_bytes(os.urandom(1000))
    os.utime(small, (time.time() - 3600, time.time() - 3600))
    with _lab(url, owner_token, folder) as lab:
        mission_id = upload("small", small)
        lab.end_of(lab.launch(mission_id, _TRIVIAL))  # warm: the image, the cache
        return [
            *_latency_rows(lab, mission_id),
            _cache_row(lab, mission_id, folder, upload),
            _log_row(lab, mission_id),
            _many_row(lab, mission_id),
        ]


def _latency_rows(lab: _Lab, mission_id: str) -> list[dict[str, object]]:
    begun, over, bare = [], [], []
    for _ in range(_TIMES):
        run = lab.end_of(lab.launch(mission_id, _TRIVIAL))
        _see_that_it_is_whole(lab, run)
        begun.append(_between(run, "created_at", "started_at"))
        over.append(_between(run, "created_at", "ended_at"))
        bare.append(_bare(lab))
    how = "container" if lab.docker is not None else "process"
    beside = "docker run" if lab.docker is not None else "the same Python alone"
    ratio = statistics.median(over) / statistics.median(bare)
    return [
        {
            "what": f"queued to started ({how}), image and cache warm",
            "measured": f"median {statistics.median(begun):.2f} s, slowest {max(begun):.2f} s",
            "bar": "<= 1.0 s",
            "met": statistics.median(begun) <= 1.0,
            "seconds": begun,
        },
        {
            "what": f"a trivial run, queued to done with log and artifact stored ({how})",
            "measured": f"median {statistics.median(over):.2f} s, slowest {max(over):.2f} s; "
            f"{ratio:.1f} x {beside} ({statistics.median(bare):.2f} s)",
            "bar": "<= 2 s",
            "met": statistics.median(over) <= 2,
            "seconds": over,
            "bare_s": bare,
        },
    ]


def _bare(lab: _Lab) -> float:
    started = time.perf_counter()
    if lab.docker is None:
        subprocess.run([sys.executable, "-c", "print('hello')"], check=True, capture_output=True)
    else:
        lab.docker.docker("run", "--rm", "--network", "none", IMAGE, "/usr/bin/python3", "-c", "print('hello')")
    return time.perf_counter() - started


def _see_that_it_is_whole(lab: _Lab, run: Any) -> None:
    """Check that a run succeeded, and that its log and artifacts exist."""
    artifacts = lab.ask("GET", f"runs/{run['id']}/artifacts")["items"]
    log = lab.ask("GET", f"runs/{run['id']}/log")
    if (run["state"], [run_id["path"] for run_id in artifacts], log["text"]) != ("done", ["left.txt"], "hello\n"):
        raise SystemExit(f"not a good run: {run['state']} {run['message']} {artifacts} {log}")


def _between(run: Any, first: str, last: str) -> float:
    return (datetime.fromisoformat(run[last]) - datetime.fromisoformat(run[first])).total_seconds()


def _cache_row(lab: _Lab, mission_id: str, folder: Path, upload: Callable[[str, Path], str]) -> dict[str, object]:
    """The cost of 1 GB of cached inputs, compared with the same run on one small file."""
    large = folder / "large.bin"
    with large.open("wb") as stream:
        for _ in range(100):
            stream.write(os.urandom(10 * _MB))
    os.utime(large, (time.time() - 3600, time.time() - 3600))
    large_id = upload("large", large)
    lab.end_of(lab.launch(large_id, _TRIVIAL))
    ours, small = [], []
    for _ in range(_TIMES):
        ours.append(_between(lab.end_of(lab.launch(large_id, _TRIVIAL)), "claimed_at", "started_at"))
        small.append(_between(lab.end_of(lab.launch(mission_id, _TRIVIAL)), "claimed_at", "started_at"))
    more = statistics.median(ours) - statistics.median(small)
    return {
        "what": "inputs of 1 GB out of the runner's cache, beside one small file",
        "measured": f"{more * 1000:.0f} ms more",
        "bar": "<= 50 ms",
        "met": more <= 0.050,
        "ours_s": ours,
        "small_s": small,
    }


def _log_row(lab: _Lab, mission_id: str) -> dict[str, object]:
    """A run that writes 10 MB/s: every line must be stored, and the API as fast as without the run."""
    beside = _latencies_during(lab, lambda: _bare_writing(lab))
    run_id = lab.launch(mission_id, _WRITING)
    ended: list[Any] = []
    meanwhile = _latencies_during(lab, lambda: ended.append(lab.end_of(run_id)))
    lines = _lines_of(lab, run_id)
    line_count = _LOG_MB * _MB // _LOG_LINE_BYTES
    in_order = all(int(line[:9]) == number for number, line in enumerate(lines))
    seconds = _between(ended[0], "started_at", "ended_at")
    ratio = statistics.median(meanwhile) / statistics.median(beside)
    return {
        "what": f"a run that writes {_LOG_MB} MB at 10 MB/s",
        "measured": f"{len(lines)} of {line_count} lines, {'in order' if in_order else 'NOT in order'}; kept after "
        f"{seconds:.1f} s; the API answers in {_ms(meanwhile)}, beside what writes as much and is no run {_ms(beside)}",
        "bar": "all lines, in order; the API not slower than 2 x",
        "met": len(lines) == line_count and in_order and ratio <= 2,
    }


def _bare_writing(lab: _Lab) -> None:
    if lab.docker is None:
        subprocess.run([sys.executable, "-c", _WRITING], check=True, capture_output=True)
    else:
        lab.docker.docker("run", "--rm", "--network", "none", IMAGE, "/usr/bin/python3", "-c", _WRITING)


def _latencies_during(lab: _Lab, work: Callable[[], object]) -> Sequence[float]:
    """Send ordinary requests to the API until the block ends; return the time of each."""
    thread = threading.Thread(target=work)
    thread.start()
    times: list[float] = []
    while thread.is_alive():
        started = time.perf_counter()
        lab.ask("GET", "missions?limit=10")
        times.append(time.perf_counter() - started)
        time.sleep(0.02)
    return times


def _ms(times: Sequence[float]) -> str:
    return f"{statistics.median(times) * 1000:.0f} ms"


def _lines_of(lab: _Lab, run_id: str) -> list[str]:
    parts: list[str] = []
    offset, is_over = 0, False
    while not is_over:
        piece = lab.ask("GET", f"runs/{run_id}/log?offset={offset}")
        parts.append(piece["text"])
        offset, is_over = piece["next_offset"], piece["is_over"]
    return "".join(parts).splitlines()


def _many_row(lab: _Lab, mission_id: str) -> dict[str, object]:
    """Many trivial runs on two slots."""
    started = time.perf_counter()
    run_ids = [lab.launch(mission_id, _TRIVIAL) for _ in range(_MANY)]
    runs = [lab.end_of(run_id, within_s=900) for run_id in run_ids]
    took = time.perf_counter() - started
    for run in runs:
        _see_that_it_is_whole(lab, run)
    again = sum(1 for run in runs if run["attempt"] != 1)
    return {
        "what": f"{_MANY} trivial runs on two slots",
        "measured": f"all done once with log and artifact, in {took:.0f} s; {again} begun again",
        "bar": "none lost, doubled or stuck",
        "met": again == 0,
        "also": f"{took / _MANY:.2f} s a run",
    }
