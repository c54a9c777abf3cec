"""The row about Arrow tables: an IMU topic from memory, from a file of its own, from a file of all topics."""

import statistics
from pathlib import Path

from benchmarks.measure import Run, take_turns
from kleinkram.recordings import Recording
from kleinkram.recordings.writing.mcap_writer import McapWriter

_SIDES = "benchmarks.arrow_sides"
_OTHERS = {"arrow_small_mcap": "small-mcap with mcap-ros2-support-fast", "arrow_mcap": "mcap with mcap-ros2-support"}
_RUNS = 3
_MOST_MB = 200
_LEAST_PER_S = 300_000
_IMU = "/imu/data"
_MESSAGES = 150_000
"""Twelve minutes; 50 MB as a table."""


def arrow_row(path: Path) -> dict[str, object]:
    """An IMU topic to an Arrow table of all fields, by every reader that can; `path`: a file of all topics."""
    alone = _imu_alone(path)
    runs = take_turns(["arrow_ours", "arrow_at_hand", *_OTHERS], str(alone), _IMU, module=_SIDES, rounds=_RUNS)
    runs["among"] = take_turns(["arrow_ours"], str(path), _IMU, module=_SIDES, rounds=_RUNS)["arrow_ours"]
    if len({run.facts["columns"] for side in runs.values() for run in side}) != 1:
        raise SystemExit("the sides made different tables")
    rates = {name: _rate(side) for name, side in runs.items()}
    fastest = max(_OTHERS, key=rates.__getitem__)
    ratio = rates["arrow_ours"] / rates[fastest]
    peaks = _peak_mb(runs["arrow_ours"]), _peak_mb(runs["among"])
    return {
        "what": f"an IMU topic to Arrow, from an MCAP of nothing else ({_MESSAGES} messages)",
        "measured": (
            f"{rates['arrow_ours']:.0f} messages/s, {ratio:.1f}x of the fastest public reader "
            f"({_OTHERS[fastest]}, {rates[fastest]:.0f}); {rates['arrow_at_hand']:.0f} from messages at hand"
        ),
        "also": (
            f"{peaks[0]:.0f} MB with the table; out of a 1 GB MCAP of all topics, in every chunk of which it is: "
            f"{rates['among']:.0f} messages/s, {statistics.median(run.seconds for run in runs['among']):.2f} s, "
            f"{peaks[1]:.0f} MB (bar {_MOST_MB})"
        ),
        "bar": f">= {_LEAST_PER_S} messages/s, >= 1.0x",
        "met": min(rates["arrow_ours"], rates["arrow_at_hand"]) >= _LEAST_PER_S
        and ratio >= 1
        and max(peaks) <= _MOST_MB,
        "messages_per_s": rates,
        "peak_mb": peaks,
    }


def _imu_alone(path: Path) -> Path:
    """Write the IMU messages of a file again and again, into a file beside it, at the rate that they have."""
    target = path.with_name("imu.mcap")
    with Recording.open(path) as recording, target.open("wb") as stream:
        schema = recording.topic(_IMU).schema
        messages = list(recording.raw_messages(_IMU))
        writer = McapWriter(stream, profile="ros2")
        channel = writer.add_channel(_IMU, writer.add_schema(schema.name, schema.encoding, schema.data), "cdr")
        for number in range(_MESSAGES):
            again, place = divmod(number, len(messages))
            message = messages[place]
            log_ns = message.log_time_ns + again * ((recording.end_ns or 0) - (recording.start_ns or 0))
            writer.add_message(channel, log_ns, message.data, publish_time_ns=log_ns)
        writer.finish()
    return target


def _rate(runs: list[Run]) -> float:
    return statistics.median(run.facts["messages"] / run.seconds for run in runs)


def _peak_mb(runs: list[Run]) -> float:
    return max(run.peak_mb for run in runs)
