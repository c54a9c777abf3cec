"""Makes a dataset of ray.data with a row for each message that a search finds.

`python search_with_ray.py 'project:alpine topic:/imu/data' /imu/data`

Each block of the dataset is read by a worker, straight from the store.
"""

import sys
from collections.abc import Iterator
from typing import Any

import ray

import kleinkram
from kleinkram.recordings import Recording


def read(row: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the messages of a topic of one recording as rows."""
    recording: Recording = row["item"]
    with recording:
        table = recording.to_arrow(row["topic"])
    return table.to_pylist()


def recordings(query: str, topic: str) -> Iterator[dict[str, Any]]:
    """Yield each recording that a search finds, with the topic to read."""
    with kleinkram.connect() as client:
        files = client.files.list(query)
        for recording_id in dict.fromkeys(file.recording_id for file in files if file.recording_id):
            yield {"item": client.recordings.open(recording_id), "topic": topic}


def main(query: str, topic: str) -> None:
    """Print the number of messages, and the mean of each component of their linear accelerations."""
    dataset = ray.data.from_items(list(recordings(query, topic))).flat_map(read)
    print(dataset.count(), "messages")
    for axis in "xyz":
        print(axis, round(dataset.mean(f"linear_acceleration.{axis}"), 4), "m/s²")


if __name__ == "__main__":
    main(*sys.argv[1:])
