"""Finds gaps in a topic of one recording: `imu_gaps.py RECORDING TOPIC LIMIT_S GAPS.csv REPORT.json`.

The table has a row for each gap; the report is in the format of reports of runs.
"""

import csv
import itertools
import json
import sys
from pathlib import Path

from kleinkram.recordings import Recording

_NS = 1e9


def main(recording_path: str, topic: str, limit_s: str, table_path: str, report_path: str) -> None:
    """Write the gaps and the report."""
    with Recording.open(recording_path) as recording:
        times = [message.log_time_ns for message in recording.raw_messages(topic)]
    pairs = [(start, end - start) for start, end in itertools.pairwise(times)]
    gaps = [(start, length / _NS) for start, length in pairs if length / _NS > float(limit_s)]
    longest_s = max((length / _NS for _, length in pairs), default=0.0)
    with Path(table_path).open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["start_ns", "length_s"])
        table.writerows(gaps)
    metrics = [
        {"name": "gap_count", "value": len(gaps), "topic": topic},
        {"name": "longest_gap", "value": longest_s, "unit": "s", "topic": topic},
    ]
    Path(report_path).write_text(json.dumps({"metrics": metrics}))


if __name__ == "__main__":
    main(*sys.argv[1:])
