"""One hour of many clients on ten years of data: the memory of API and worker does not grow."""

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from benchmarks.scale import seed
from benchmarks.scale.places import seeded

from tests.system.chaos.kill_rounds import say
from tests.system.cluster import Cluster

_SECONDS = float(os.environ.get("KLEINKRAM_SOAK_S", "3600"))
_CLIENTS, _LOOKS = 10, 60
# The last third is compared with the second, because caches fill during the first.
_MAX_GROWTH, _SLACK_MB = 1.1, 10


@pytest.mark.soak
def test_memory_stays_constant_during_an_hour_of_many_clients(tmp_path: Path) -> None:
    cluster = Cluster(tmp_path, settings={"KLEINKRAM_SEARCHES_PER_MINUTE": "0"})
    cluster.start()
    try:
        parts = {name: psutil.Process(cluster.runtime_info()["services"][name]) for name in ("api", "worker")}
        seed.fill(parts["worker"].environ()["KLEINKRAM_DATABASE_URL"], seed.Size(1), say=lambda _text: None)
        token = (cluster.data_dir / "owner-token").read_text().strip()
        arguments = [cluster.runtime_info()["url"], token, str(_CLIENTS), str(_SECONDS), str(seeded("project1"))]
        taken: dict[str, list[float]] = {name: [] for name in parts}
        with subprocess.Popen(
            [sys.executable, "-m", "benchmarks.scale.crowd", *arguments], stdout=subprocess.PIPE
        ) as crowd:
            try:
                while crowd.poll() is None:
                    for name, part in parts.items():
                        taken[name].append(part.memory_full_info().pss / 1e6)
                    time.sleep(_SECONDS / _LOOKS)
            finally:
                crowd.kill()
            runtime_info = json.loads(crowd.communicate()[0])
    finally:
        cluster.end()
    say(f"{runtime_info['answers']} answers in {_SECONDS:.0f} s")
    thirds = {}
    for name, mb in taken.items():
        third = len(mb) // 3
        middle, last = statistics.median(mb[third : 2 * third]), statistics.median(mb[2 * third :])
        say(f"{name}: {mb[0]:.0f} MB at first, {middle:.0f} in the second third, {last:.0f} in the last")
        thirds[name] = middle, last
    assert runtime_info["answers"] > 0
    assert runtime_info["errors"] == []
    for name, (middle, last) in thirds.items():
        assert last <= middle * _MAX_GROWTH + _SLACK_MB, (
            f"{name} grew from {middle:.0f} to {last:.0f} MB: {taken[name]}"
        )
