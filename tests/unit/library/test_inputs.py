"""Which recording of a mission an action reads."""

import pytest

from kleinkram.contract.names import split_trajectory_name
from kleinkram.library import inputs
from kleinkram.library.inputs import InputRecording, only_recording
from kleinkram.recordings import Schema, Topic
from kleinkram.recordings.trajectories import TrajectoryRefused

ODOMETRY = Topic("/odom", "nav_msgs/Odometry", Schema("nav_msgs/Odometry", "ros1msg", b""), "ros1", 1, None)


def recording(name: str, *, is_derived: bool = False) -> InputRecording:
    return InputRecording(name, (), (ODOMETRY,), is_derived)


def is_odometry(topic: Topic) -> bool:
    return topic.name == "/odom"


def test_the_original_comes_before_copies_that_runs_made() -> None:
    original, copy = recording("drive.bag"), recording("derived/drive.mcap", is_derived=True)
    assert only_recording("/odom", [copy, original], is_odometry) is original
    assert only_recording("/odom", [copy], is_odometry) is copy


def test_of_two_originals_one_must_be_named() -> None:
    with pytest.raises(
        TrajectoryRefused, match=r"^/odom: 2 recordings have it: a.bag, b.bag; name one, such as a.bag:/odom"
    ):
        only_recording("/odom", [recording("a.bag"), recording("b.bag")], is_odometry)


@pytest.mark.parametrize(
    ("source", "name", "rest"),
    [
        ("tf:/map->/base_link", None, "tf:/map->/base_link"),
        ("tf:map->base_link", None, "tf:map->base_link"),
        ("truth.tum", None, "truth.tum"),
        ("nuc/nuc.mcap:tf:/map->/base", "nuc/nuc.mcap", "tf:/map->/base"),
        ("nuc.mcap:/odom", "nuc.mcap", "/odom"),
    ],
)
def test_a_frame_with_a_slash_is_no_recording(source: str, name: str | None, rest: str) -> None:
    assert split_trajectory_name(source) == (name, rest)


def test_a_path_with_the_letters_of_a_glob_is_that_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inputs, "_input_paths", lambda: ["run1.tum", "run[1].tum"])
    monkeypatch.setattr(inputs, "_read_file", lambda path: TrajectoryRefused(path, "was read"))
    for source, read in (("run[1].tum", "run[1].tum"), ("run[0-9].tum", "run1.tum")):
        with pytest.raises(TrajectoryRefused) as caught:
            inputs.read_trajectories(source, [])
        assert str(caught.value) == f"{read}: was read"
