"""Benchmark of the shared cache: 50 jobs need the same 1 GB, each with a process of its own, like on 50 compute nodes.

What the store sends is counted at its process, in plain downloads of the same file: some stores pass bytes on inside.
"""

import json
import os
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import urllib3

from benchmarks.instance import klein
from kleinkram.contract.runners import ClaimReply
from kleinkram.runner.input_cache import InputCache
from kleinkram.runner.node_transfers import order_transfers, read_status
from kleinkram.runner.state_directory import StateDirectory

_JOBS = int(os.environ.get("KLEINKRAM_BENCH_JOBS", "50"))
_BYTES = int(os.environ.get("KLEINKRAM_BENCH_SHARED_MB", "1000")) * 10**6
_ROOM = {"cores": 1000, "memory_bytes": 10**12, "disk_bytes": 10**13, "gpus": 0}
_ABILITIES = {
    "executor": "slurm",
    "isolation": "namespaces",
    "images": False,
    "networks": ["none"],
    "gpus": False,
    "bounds_memory": True,
    "bounds_disk": True,
}


def shared_inputs_row(
    url: str, owner_token: str, store: psutil.Process, folder: Path, upload: Callable[[str, Path], str]
) -> dict[str, object]:
    """Return a row about what the store sends; `upload` uploads a file to a new mission and returns its id."""
    folder.mkdir(parents=True)
    source = folder / "large.bin"
    with source.open("wb") as stream:
        for _ in range(100):
            stream.write(os.urandom(_BYTES // 100))
    os.utime(source, (time.time() - 3600, time.time() - 3600))
    mission_id = upload("shared", source)
    source.unlink()
    sent_before = _sent_bytes(store)
    klein("download", "-p", "bench", "-m", "shared", "--dest", str(folder / "plain"))
    plain = _sent_bytes(store) - sent_before
    directories = _claim_runs(url, owner_token, mission_id, folder)
    sent_before, started = _sent_bytes(store), time.perf_counter()
    steps = [
        subprocess.Popen([sys.executable, "-I", "-m", "kleinkram.runner.node_transfers", "fetch", str(directory)])
        for directory in directories
    ]
    codes = [step.wait() for step in steps]
    took_s, sent = time.perf_counter() - started, _sent_bytes(store) - sent_before
    inodes = {path.stat().st_ino for directory in directories for path in (directory / "in").glob("*.bin")}
    statuses = [read_status(directory) for directory in directories]
    fetched = sum(status.store_bytes for status in statuses if status is not None)
    return {
        "what": f"an input of {_BYTES / 1e9:g} GB for {_JOBS} jobs at once, by a shared cache",
        "measured": f"sent {sent / plain:.3f} times by the store, {fetched / 1e9:.3f} GB received by all jobs together",
        "bar": "once",
        "met": codes == [0] * _JOBS and sent < 1.05 * plain and fetched == _BYTES and len(inodes) == 1,
        "also": f"{took_s:.1f} s until all {_JOBS} had it",
    }


def _claim_runs(url: str, owner_token: str, mission_id: str, folder: Path) -> list[Path]:
    """Launch runs, claim them as a runner, and leave what their nodes need; return their directories."""
    with urllib3.PoolManager(retries=False, timeout=60) as pool:

        def post(path: str, token: str, body: object) -> Any:
            headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
            answer = pool.request("POST", f"{url}/api/v1/{path}", body=json.dumps(body), headers=headers)
            if answer.status >= 300:
                raise SystemExit(f"{path}: {answer.status} {answer.data.decode()}")
            return json.loads(answer.data)

        label = f"only-{uuid.uuid4().hex[:8]}"
        definition = {"name": "shared", "script": "print(1)", "resources": {"labels": [label]}}
        secret = post("tokens", owner_token, {"name": "shared", "kind": "runner"})["secret"]
        state_folder = folder / "runner"
        state_folder.mkdir(mode=0o700)
        state = StateDirectory(state_folder)
        hello = {
            "id": str(state.runner_id),
            "name": label,
            "labels": [label],
            "capacity": _ROOM,
            "version": "0",
            "lease_s": 900,
        }
        post("runners", secret, {**hello, "abilities": _ABILITIES})
        for _ in range(_JOBS):
            launch = {"mission_ids": [mission_id], "definition": definition, "force": True}
            post("runs", owner_token, launch)
        token_file = folder / "token"
        token_file.touch(0o600)
        token_file.write_text(secret)
        cache = InputCache(state_folder / "cache", 2 * _BYTES)
        directories: list[Path] = []
        active: list[str] = []
        for _ in range(_JOBS):
            request = {"free": _ROOM, "wait_s": 5, "active_run_ids": active}
            claim = ClaimReply.model_validate(post(f"runners/{state.runner_id}/claims", secret, request))
            if claim.run is None:
                raise SystemExit("a run is missing")
            active.append(str(claim.run.run_id))
            attempt = state.create_attempt(claim.run)
            (attempt.directory / "in").mkdir()
            order_transfers(attempt.directory, url, token_file, cache, copy_inputs=False)
            directories.append(attempt.directory)
        return directories


def _sent_bytes(process: psutil.Process) -> int:
    """Return the bytes that a process and its children wrote, to sockets, too."""
    processes = [process, *process.children(recursive=True)]
    return sum(int(one.io_counters().write_chars) for one in processes)
