"""The world of the sample missions: lidars measure its walls and floor, cameras show it, from where the robot is."""

import math
import random
from itertools import pairwise

import pytest

from kleinkram.recordings.sample import motion
from kleinkram.recordings.sample.jpeg import mosaic_jpeg
from kleinkram.recordings.sample.motion import Motion, MotionState, Mount
from kleinkram.recordings.sample.scene import _BUILDINGS, _COURTYARD, CameraView, LidarView, blurred

BOTH = pytest.mark.parametrize("path", [motion.drive, motion.walk], ids=["drive", "walk"])
TIMES_S = [0.0, 2.6, 7.3, 19.1, 33.3, 52.0, 61.7, 80.0]
NOISE_M = 0.06


def points_in_odom(view: LidarView, number: int, state: MotionState) -> list[tuple[float, float, float]]:
    scan = view.scan(number, state)
    cosine, sine = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    return [
        (state.east_m + cosine * x - sine * y, state.north_m + sine * x + cosine * y, state.up_m + z)
        for x, y, z in zip(scan[0::4], scan[1::4], scan[2::4], strict=True)
    ]


def depth_inside(box: tuple[float, float, float, float], x: float, y: float) -> float:
    """Return how far a position is inside of a box; negative outside."""
    return min(x - box[0], y - box[1], box[2] - x, box[3] - y)


def is_on_a_surface(x: float, y: float, z: float) -> bool:
    walls = min(abs(depth_inside(box, x, y)) for box in (_COURTYARD, *_BUILDINGS))
    return abs(z) < NOISE_M or walls < NOISE_M


@BOTH
def test_each_point_is_on_a_wall_or_on_the_floor(path: Motion) -> None:
    view = LidarView(1600, random.Random(1))
    for number, seconds in enumerate(TIMES_S):
        points = points_in_odom(view, number, Mount(0.1, 0.0, 0.6).pose(path(seconds)))
        assert len(points) == 1600
        assert all(is_on_a_surface(*point) for point in points)
        assert all(-0.1 < z < 12 for _, _, z in points)


@BOTH
def test_nothing_is_measured_through_a_wall(path: Motion) -> None:
    view = LidarView(640, random.Random(1))
    for number, seconds in enumerate(TIMES_S):
        state = Mount(0.0, 0.0, 0.6).pose(path(seconds))
        for x, y, _ in points_in_odom(view, number, state):
            for share in (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95):
                at = (state.east_m + share * (x - state.east_m), state.north_m + share * (y - state.north_m))
                assert all(depth_inside(box, *at) < NOISE_M for box in _BUILDINGS)
                assert depth_inside(_COURTYARD, *at) > -NOISE_M


@BOTH
def test_the_robot_keeps_clear_of_the_walls(path: Motion) -> None:
    for tenth in range(1000):
        state = path(tenth / 10)
        assert all(depth_inside(box, state.east_m, state.north_m) < -1 for box in _BUILDINGS)


@BOTH
def test_the_motion_is_consistent(path: Motion) -> None:
    """Velocities are the derivatives of positions, and accelerations those of velocities."""
    step = 1e-4
    for seconds in (0.5, 2.4, 2.8, 5.21, 30.0):
        before, state, after = (path(seconds + shift) for shift in (-step, 0, step))
        velocity = [(after[axis] - before[axis]) / 2 / step for axis in range(2)]
        forward = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
        assert velocity == pytest.approx([axis * state.speed_m_s for axis in forward], abs=1e-3)
        assert (after.yaw_rad - before.yaw_rad) / 2 / step == pytest.approx(state.turn_rad_s, abs=1e-3)
        acceleration = [(after[axis] - 2 * state[axis] + before[axis]) / step**2 for axis in range(3)]
        along, across = forward, (-forward[1], forward[0])
        expected = [along[axis] * state.forward_m_s2 + across[axis] * state.left_m_s2 for axis in range(2)]
        assert acceleration == pytest.approx([*expected, state.up_m_s2], abs=0.02)


def test_the_legged_robot_stands_before_it_walks() -> None:
    assert motion.walk(0) == motion.walk(1.9)
    assert motion.walk(2.5) != motion.walk(2.6)


def test_scans_differ_by_pose_and_number() -> None:
    view = LidarView(320, random.Random(1))
    state = motion.drive(1.0)._replace(up_m=0.6)
    assert view.scan(3, state) == view.scan(3, state)
    assert view.scan(3, state) != view.scan(4, state)
    moved = points_in_odom(view, 3, motion.drive(3.0)._replace(up_m=0.6))
    assert moved != points_in_odom(view, 3, state)


@pytest.mark.parametrize("points", [1, 16, 17, 64, 40_000])
def test_a_scan_has_whole_rings(points: int) -> None:
    view = LidarView(points, random.Random(1))
    assert view.points == max(16, points // 16 * 16)
    assert len(view.scan(9, motion.drive(4.0)._replace(up_m=0.6))) == 4 * view.points


def test_a_wall_in_front_of_the_camera_is_as_high_as_it_should_be() -> None:
    """From 20 metres, with a focal length of 20 tiles, a wall reaches as many tiles up as it has metres above."""
    view = CameraView(40, 30, random.Random(1))
    facing_east = MotionState(18.0, 26.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # the courtyard ends at 38 m
    tiles = view.picture(0, facing_east._replace(north_m=-26.0))
    column = tiles[20::40]
    assert [value & ~4 for value in column[:3]] == [205 & ~4] * 3
    assert sum(1 for value in column if value & ~4 == 205 & ~4) == 15 - 11
    assert len(set(column[4:15])) > 2  # bands


@BOTH
def test_pictures_change_with_the_pose(path: Motion) -> None:
    view = CameraView(40, 30, random.Random(1))
    pictures = [view.picture(7, Mount(0.3, 0.0, 0.4).pose(path(seconds))) for seconds in TIMES_S]
    assert view.picture(7, Mount(0.3, 0.0, 0.4).pose(path(TIMES_S[0]))) == pictures[0]
    for before, after in pairwise(pictures[1:]):
        changes = [abs(a - b) for a, b in zip(before, after, strict=True)]
        assert sum(changes) / len(changes) > 10


def test_a_standing_camera_has_noise() -> None:
    view = CameraView(40, 30, random.Random(1))
    pictures = {view.picture(number, motion.walk(0.0)._replace(up_m=0.4)) for number in range(20)}
    assert len(pictures) == 20


def test_a_blurred_picture_has_the_same_mean_and_no_edges() -> None:
    view = CameraView(40, 30, random.Random(1))
    sharp = view.picture(0, motion.walk(5.0)._replace(up_m=0.4))
    soft = blurred(sharp, 40)
    assert len(soft) == len(sharp)
    assert sum(soft) / len(soft) == pytest.approx(sum(sharp) / len(sharp), abs=12)
    assert max(abs(a - b) for a, b in pairwise(soft[:40])) < 30 < max(abs(a - b) for a, b in pairwise(sharp[400:440]))


@pytest.mark.parametrize("tiles", [bytes(12), b"\xff" * 12, bytes(range(0, 252, 21)), b"\x00\xff" * 6])
def test_a_mosaic_is_a_jpeg(tiles: bytes) -> None:
    from io import BytesIO

    from PIL import Image

    picture = Image.open(BytesIO(mosaic_jpeg(tiles, 4)))
    assert picture.size == (32, 24)
    centres = [picture.getpixel((8 * column + 4, 8 * row + 4)) for row in range(3) for column in range(4)]
    assert centres == pytest.approx(list(tiles), abs=1)
