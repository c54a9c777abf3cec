"""Sample missions: realistic recordings of a small vehicle, of any size, with known contents.

For demonstrations, tests and benchmarks. Never imported by the server.
"""

from kleinkram.recordings.sample.mission import (
    FileTruth,
    MissionTruth,
    SampleFormat,
    TopicTruth,
    generate_bag,
    generate_db3,
    generate_mcap,
    generate_mission,
)
from kleinkram.recordings.sample.vehicle import Faults, TopicGap

__all__ = [
    "Faults",
    "FileTruth",
    "MissionTruth",
    "SampleFormat",
    "TopicGap",
    "TopicTruth",
    "generate_bag",
    "generate_db3",
    "generate_mcap",
    "generate_mission",
]
