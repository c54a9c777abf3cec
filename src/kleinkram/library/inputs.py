"""Recordings, topics and trajectories among the inputs of a run.

A trajectory is named by a text:

* `derived/*.tum`: files in the format of TUM, KITTI or EuRoC; a glob of their paths in the mission;
* `/odom`: a topic of poses;
* `tf:map->base_link`: a frame in another one, by the transforms of a recording;
* `nuc/*.mcap:/odom`, `nuc/nuc.mcap:tf:map->base_link`: the same, of the recording with this path.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from kleinkram.action import context, report
from kleinkram.action.run_files import in_dir
from kleinkram.contract.names import read_frames, split_trajectory_name
from kleinkram.recordings import FileSource, Recording, RecordingError, Topic
from kleinkram.recordings.recording_groups import read_folder
from kleinkram.recordings.trajectories import (
    Trajectory,
    TrajectoryRefused,
    read_file,
    read_topic,
    read_transforms,
)

_TRANSFORM_TYPES = ("TFMessage", "tfMessage")
_SHOWN = 10


@dataclass(frozen=True)
class InputRecording:
    """A recording among the inputs. `paths`: its files, a metadata.yaml first; `topics`: by name.

    `is_derived`: a run made it, such as a conversion of another recording.
    """

    name: str
    paths: tuple[Path, ...]
    topics: tuple[Topic, ...]
    is_derived: bool = False

    @contextmanager
    def open(self) -> Iterator[Recording]:
        """Open it for reading, for the duration of a `with`."""
        with _opened(self.paths) as recording:
            yield recording


@contextmanager
def _opened(paths: Sequence[Path]) -> Iterator[Recording]:
    with ExitStack() as stack:
        folders = {path.parent for path in paths}
        if len(paths) == 1 or (paths[0].name == "metadata.yaml" and len(folders) == 1):
            yield stack.enter_context(Recording.open(paths[0]))
        else:
            yield stack.enter_context(Recording.open([stack.enter_context(FileSource(path)) for path in paths]))


def input_recordings() -> list[InputRecording]:
    """Return the recordings among the inputs, by name, with their topics. One that cannot be read becomes a finding."""
    recordings: list[InputRecording] = []
    derived = {file.path for file in context().files if file.is_derived}
    for group in read_folder(in_dir).groups:
        names = [*([group.metadata_path] if group.metadata_path else []), *group.members]
        paths = tuple(in_dir / name for name in names)
        try:
            with _opened(paths) as recording:
                is_derived = not derived.isdisjoint(group.members)
                recordings.append(InputRecording(group.name, paths, recording.topics, is_derived))
        except RecordingError as error:
            report.finding("warning", "recording.unreadable", str(error)[:1000], file=paths[-1])
    return recordings


@dataclass(frozen=True)
class InputTrajectory:
    """A trajectory and the inputs that it was read from."""

    trajectory: Trajectory
    paths: tuple[Path, ...]


def read_trajectories(source: str, recordings: Sequence[InputRecording]) -> list[InputTrajectory | TrajectoryRefused]:
    """Return the trajectories that a text names (see the module), or why one of several cannot be used.

    Raises:
        TrajectoryRefused: there is none, or several recordings have the topic.
    """
    paths = [path for path in _input_paths() if path == source]
    paths = paths or [path for path in _input_paths() if fnmatchcase(path, source)]
    if paths:
        results = [_read_file(path) for path in paths]
        if len(results) == 1 and isinstance(results[0], TrajectoryRefused):
            raise results[0]
        return results
    return [_from_recording(source, recordings)]


def read_trajectory(source: str, recordings: Sequence[InputRecording]) -> InputTrajectory:
    """Return the trajectory that a text names.

    Raises:
        TrajectoryRefused: there is none, it cannot be used, or there are several.
    """
    results = read_trajectories(source, recordings)
    if len(results) > 1:
        names = [result.name if isinstance(result, TrajectoryRefused) else result.trajectory.name for result in results]
        raise TrajectoryRefused(source, f"{len(names)} files match, but one is needed: {_shown(names)}")
    if isinstance(results[0], TrajectoryRefused):
        raise results[0]
    return results[0]


def _read_file(path: str) -> InputTrajectory | TrajectoryRefused:
    try:
        return InputTrajectory(read_file(in_dir / path, name=path), (in_dir / path,))
    except TrajectoryRefused as refusal:
        return refusal


def _input_paths() -> list[str]:
    return sorted(file.path for file in context().files)


def _from_recording(source: str, recordings: Sequence[InputRecording]) -> InputTrajectory:
    name, rest = split_trajectory_name(source)
    glob = "*" if name is None else name
    selected = [recording for recording in recordings if recording.name == glob or fnmatchcase(recording.name, glob)]
    if name is not None and not selected:
        raise TrajectoryRefused(
            source, f"no recording is called {name}; there are {_shown([r.name for r in recordings])}"
        )
    try:
        frames = read_frames(rest)
    except ValueError as error:
        raise TrajectoryRefused(source, str(error)) from None
    if frames is not None:
        recording = only_recording(source, selected, has_transforms)
        with recording.open() as reader:
            return InputTrajectory(read_transforms(reader, *frames), recording.paths)
    recording = only_recording(source, selected, lambda topic: topic.name == rest)
    with recording.open() as reader:
        return InputTrajectory(read_topic(reader, rest), recording.paths)


def only_recording(
    source: str, recordings: Sequence[InputRecording], condition: Callable[[Topic], bool]
) -> InputRecording:
    """Return the only recording with a topic that meets a condition; one that no run made comes before its copies.

    Raises:
        TrajectoryRefused: there is none or several; the sentence says how to name one.
    """
    matching = [recording for recording in recordings if any(map(condition, recording.topics))]
    matching = [recording for recording in matching if not recording.is_derived] or matching
    if not matching:
        files = _input_paths()
        raise TrajectoryRefused(source, f"the inputs have no such file or topic; the files are {_shown(files)}")
    if len(matching) > 1:
        names = [recording.name for recording in matching]
        rest = source if source.startswith(("/", "tf:")) else f"/{source}"
        raise TrajectoryRefused(
            source, f"{len(names)} recordings have it: {_shown(names)}; name one, such as {names[0]}:{rest}"
        )
    return matching[0]


def has_transforms(topic: Topic) -> bool:
    """Return whether a topic has transforms (tf)."""
    return topic.message_type.rpartition("/")[2] in _TRANSFORM_TYPES


def _shown(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return (", ".join(names[:_SHOWN]) or "none") + more
