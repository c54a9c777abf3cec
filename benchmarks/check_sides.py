"""Sides of the benchmarks of checks, each run as a process of its own (see `side`)."""

import time
from pathlib import Path

from benchmarks.check_missions import RULES
from benchmarks.side import Facts, main
from kleinkram.checks.document import Profile, read_checks
from kleinkram.checks.facts import MissionFacts, RecordingFacts, TopicFacts
from kleinkram.checks.local import read_mission
from kleinkram.checks.results import evaluate, evaluate_index
from kleinkram.contract.checks import CheckDepth, CheckStatus
from kleinkram.recordings.model import Content

_NS = 1_000_000_000
_START_NS = 1_700_000_000 * _NS


def check_content(folder: str) -> Facts:
    """Check a folder by content; warm cache, since all files are read once before."""
    files = _files(folder)
    for path in files.values():
        with path.open("rb") as file:
            while file.read(2**24):
                pass
    return _measured(files, CheckDepth.content)


def check_indexes(folder: str) -> Facts:
    """Check a folder by its indexes."""
    return _measured(_files(folder), CheckDepth.index)


def _files(folder: str) -> dict[str, Path]:
    return {path.name: path for path in sorted(Path(folder).iterdir())}


def _measured(files: dict[str, Path], depth: CheckDepth) -> Facts:
    document = read_checks(RULES)
    read_before, start = _bytes_read(), time.perf_counter()
    results = evaluate(document, read_mission(files), depth)
    seconds = time.perf_counter() - start
    good = results.counts[CheckStatus.ok]
    bad = sum(results.counts[status] for status in (CheckStatus.error, CheckStatus.warning))
    not_made = results.counts[CheckStatus.not_made]
    size = sum(path.stat().st_size for path in files.values())
    return {
        "seconds": seconds,
        "read": _bytes_read() - read_before,
        "size": size,
        "good": good,
        "bad": bad,
        "not_made": not_made,
    }


def _bytes_read() -> int:
    """Return the bytes that this process has read of files, from the disk or from the cache. Source: proc(5), rchar."""
    return int(Path("/proc/self/io").read_text().split()[1])


def reevaluate(missions: str, topics: str) -> Facts:
    """Evaluate the index checks of many missions, as after a change of checks.yaml."""
    names = [f"/sensor/{number}" for number in range(int(topics))]
    rules = {name: {"rate": 10, "max_gap": "500ms", "type": "sensor_msgs/Imu", "covers": "90%"} for name in names}
    profile = Profile.model_validate({"topics": rules, "imu": {"*": {}}})
    document = read_checks("version: 1\nprofiles: [{topics: {/a: {}}}]").model_copy(update={"profiles": [profile]})
    facts = [_mission_facts(names, number) for number in range(int(missions))]
    start = time.perf_counter()
    rows = sum(len(evaluate_index(document, mission).checks) for mission in facts)
    return {"seconds": time.perf_counter() - start, "rows": rows}


def _mission_facts(names: list[str], number: int) -> MissionFacts:
    end_ns = _START_NS + 600 * _NS
    recording = RecordingFacts("drive", ("drive.mcap",), Content.indexed, None, _START_NS, end_ns)
    topics = tuple(
        TopicFacts(
            name, "sensor_msgs/msg/Imu", 6000, _START_NS, end_ns, 10.0 - (place == number % 40) * 5, 10**8, ("drive",)
        )
        for place, name in enumerate(names)
    )
    return MissionFacts((), (recording,), topics, _START_NS, end_ns)


if __name__ == "__main__":
    main([check_content, check_indexes, reevaluate])
