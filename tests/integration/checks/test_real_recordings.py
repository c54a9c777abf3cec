"""Content checks of real recordings: no false alarm on good ones, and nothing breaks on any other."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.checks.content import OpenRecording, check_content
from kleinkram.checks.document import read_checks
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings import Recording, RecordingError
from tests.conftest import RECORDINGS
from tests.recording_files.corpus import entries
from tests.requirements import missing

BAD = (CheckStatus.error, CheckStatus.warning)
EVERYTHING = """
  clocks: {"*": {max_stamp_offset: 500ms, max_stamp_drift: 500, max_stamp_jump: 1s, max_recorder_offset: 20ms}}
  images: {"*": {min_sharpness: 5}}
  imu: {"*": {up: z, max_acceleration: 160, max_turn_rate: 35}}
  positions: {"*": {}}
  point_clouds: {"*": {max_range: 300}}
  transforms: {"*": {}}
  odometry: {"*": {}}
  batteries: {"*": {min_voltage: 10, min_percentage: 5%}}
  values: {"*": {varies: true, min: -1e9, max: 1e9}}
"""
# What a lab would write for these recordings. Where stamps are of a simulation, or NaN is how a driver says that it
# does not measure something, there is no rule about them.
GOOD = {
    "ros1/kleinkram_imu_lz4.bag": """
  clocks: {"*": {max_stamp_offset: 100ms, max_stamp_drift: 200, max_stamp_jump: 500ms}}
  imu: {"*": {max_acceleration: 160, max_turn_rate: 35}}
  values: {"*": {}}
""",
    "mcap/kleinkram_imu_ros1profile_zstd.mcap": """
  clocks: {"*": {max_stamp_offset: 100ms, max_stamp_drift: 200, max_stamp_jump: 500ms}}
  imu: {"*": {max_acceleration: 160, max_turn_rate: 35}}
  values: {"*": {}}
""",
    "ros1/robot_localization_test1_imu_odom_gps_bz2.bag": """
  clocks: {"*": {max_stamp_offset: 500ms, max_stamp_jump: 1s}}
  imu: {"*": {}}
  odometry: {"*": {}}
  values: {"*": {}}
""",
    "ros1/robot_localization_test2_imu_odom_bz2.bag": """
  clocks: {"*": {max_stamp_offset: 500ms, max_stamp_jump: 1s}}
  imu: {"*": {}}
  odometry: {"*": {}}
  values: {"*": {}}
""",
    "ros1/scan_tools_laserscan.bag": """
  clocks: {"*": {max_stamp_offset: 500ms, max_stamp_drift: 500, max_stamp_jump: 1s}}
""",
    "ros1/embag_pointcloud2_laserscan_odom_lz4.bag": """
  point_clouds: {"*": {min_points: 100, max_range: 300}}
  odometry: {"*": {}}
""",
    "mcap/SO_bag/SO_bag_0.mcap": """
  imu: {"*": {}}
""",
}


def _checks(path: Path, sections: str) -> list[Check]:
    indented = "\n".join(f"    {line.strip()}" for line in sections.strip().splitlines())
    profiles = read_checks(f"version: 1\nprofiles:\n  - name: all\n{indented}\n").profiles
    with Recording.open(path) as recording:
        return check_content(profiles, [OpenRecording(path.name, recording)])


@pytest.mark.parametrize("name", GOOD)
def test_good_recordings_raise_no_false_alarm(name: str) -> None:
    path = RECORDINGS / name
    if not path.exists():
        missing(f"no recordings at {RECORDINGS}: set KLEINKRAM_RECORDINGS")
    rows = _checks(path, GOOD[name])
    assert [row for row in rows if row.status is not CheckStatus.ok] == []
    assert rows


@pytest.mark.parametrize("name", [entry.name for entry in entries()] or ["missing"])
def test_any_recording_can_be_checked(name: str) -> None:
    path = RECORDINGS / name
    if not path.exists():
        missing(f"no recordings at {RECORDINGS}: set KLEINKRAM_RECORDINGS")
    try:
        rows = _checks(path, EVERYTHING)
    except RecordingError as error:
        assert str(error)  # noqa: PT017  # it is no recording; the caller has its reason
        return
    assert rows
    assert all(row.message for row in rows)
    assert all(row.value is not None for row in rows if row.status in BAD and row.name.startswith(("clock", "image")))
