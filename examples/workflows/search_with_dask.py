"""Measures the rate of a topic in every recording that a search finds, with the workers of dask.

`python search_with_dask.py 'project:alpine topic:/imu/data' /imu/data [ADDRESS OF A SCHEDULER]`

The recordings are sent to the workers, which connect by themselves: a token is read there from KLEINKRAM_TOKEN.
"""

import sys

from dask.distributed import Client as Dask

import kleinkram
from kleinkram.recordings import Recording


def rate_hz(recording: Recording, topic: str) -> float:
    """Return the mean rate of a topic."""
    with recording:
        times = [message.log_time_ns for message in recording.raw_messages(topic)]
    return (len(times) - 1) / ((times[-1] - times[0]) / 1e9) if len(times) > 1 else 0.0


def main(query: str, topic: str, scheduler: str | None = None) -> None:
    """Print the rate for each recording."""
    with kleinkram.connect() as client, Dask(scheduler, n_workers=None if scheduler else 2) as dask:
        files = [file for file in client.files.list(query) if file.recording_id]
        ids = list(dict.fromkeys(file.recording_id for file in files))
        recordings = [client.recordings.open(recording_id) for recording_id in ids]
        rates = dask.gather(dask.map(rate_hz, recordings, topic=topic, pure=False))
        for recording_id, rate in zip(ids, rates, strict=True):
            print(recording_id, f"{rate:.1f} Hz")


if __name__ == "__main__":
    main(*sys.argv[1:])
