"""Trajectories as arrays: from files (TUM, KITTI, EuRoC), from topics of poses, and from the transforms of a recording.

```python
from kleinkram.recordings import Recording
from kleinkram.recordings.trajectories import read_file, read_topic, read_transforms, write_tum

truth = read_file("ground_truth.tum")
with Recording.open("drive.mcap") as recording:
    odometry = read_topic(recording, "/odom")
    robot = read_transforms(recording, "map", "base_link")
write_tum(odometry, "odometry.tum")
```

Stamps are integer nanoseconds, positions metres, orientations unit quaternions (x, y, z, w). What cannot be compared is
refused with a sentence that names the line or the time (`TrajectoryRefused`): stamps that go backward or are doubled,
numbers that are not finite, quaternions without a direction. Nothing is sorted, left out or repaired. Memory: about 200
bytes a pose. Requires numpy (`open-kleinkram[reading]`).
"""

from kleinkram.recordings.errors import TrajectoryRefused
from kleinkram.recordings.trajectories.files import read_file, write_tum
from kleinkram.recordings.trajectories.model import PoseList, Trajectory, quaternions_of, rotations_of, seconds_text
from kleinkram.recordings.trajectories.topics import POSE_TYPES, read_topic
from kleinkram.recordings.trajectories.transforms import read_transforms

__all__ = [
    "POSE_TYPES",
    "PoseList",
    "Trajectory",
    "TrajectoryRefused",
    "quaternions_of",
    "read_file",
    "read_topic",
    "read_transforms",
    "rotations_of",
    "seconds_text",
    "write_tum",
]
