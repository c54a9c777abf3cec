"""The world of the sample missions: a courtyard between buildings, seen by lidars and cameras from any pose.

All walls are vertical and parallel to the axes, and higher than any lidar ray that leaves the courtyard, so that each
ray ends at a wall or on the floor. Frame odom, metres.
"""

from __future__ import annotations

import math
import random
from array import array
from collections.abc import Iterator, Sequence
from itertools import pairwise
from operator import add, mul
from typing import NamedTuple

from kleinkram.recordings.sample.motion import MotionState

_WALL_HEIGHT_M = 12.0
_COURTYARD = (-38.0, -34.0, 38.0, 34.0)
# West, south, east and north side. None is nearer than 1.5 m to the circles of `motion`.
_BUILDINGS = (
    (-8.0, -6.0, -3.0, 2.0), (3.0, 1.0, 9.0, 5.0), (-2.0, 6.0, 3.0, 10.0), (2.0, -9.0, 6.0, -5.0),
    (17.0, -3.0, 21.0, 2.0), (-20.0, 9.0, -17.0, 11.0), (4.0, -21.0, 8.0, -18.0), (5.0, 17.0, 9.0, 20.0),
    (-14.0, -17.0, -11.0, -13.0), (29.0, -20.0, 34.0, -14.0), (24.0, 18.0, 30.0, 23.0), (-31.0, 16.0, -26.0, 24.0),
    (-34.0, -22.0, -27.0, -16.0), (-8.0, 28.0, -2.0, 31.0), (6.0, -32.0, 13.0, -28.0), (30.0, 2.0, 33.0, 6.0),
    (-33.0, -6.0, -30.0, 1.0),
)  # fmt: skip
# The rings are bands of elevations, in degrees, denser near the horizon. Half of them are below it.
_BANDS_DEG = (-16, -12, -9, -7, -5, -3.5, -2, -1, 0, 1, 2, 3, 4, 5, 6, 7, 8)
_RINGS = len(_BANDS_DEG) - 1
_RANGE_NOISE_M = 0.01
_PATTERNS, _SLOPES = 16, 2048
_NOISE_VALUES, _INTENSITIES = 16_384, 65_536
_FARTHEST_M = 100.0
_FAR = 25.0
_FAR_POINTS_EVERY = 4
_SKY, _FLOOR, _FLOOR_CONTRAST = 205, 100, 30
_WALLS = (60, 150, 95, 170, 75, 125, 180, 110, 50, 140, 85)
_BANDS, _BAND_CONTRAST = 4, 22
_STRIPE_M = 1.3
_NEAREST_M = 0.1
_FLOOR_DETAIL_M = 3.0
_NOISY_TILES, _NOISE_LEVEL = 50, 4


class _Face(NamedTuple):
    """A wall on the line x = `at_m` (or y = `at_m`) between `low_m` and `high_m` of the other axis.

    `outward`: the side from which it is seen, 1 or -1 along the axis.
    """

    number: int
    is_x: bool
    at_m: float
    low_m: float
    high_m: float
    outward: int


def _faces() -> tuple[_Face, ...]:
    sides: list[tuple[bool, float, float, float, int]] = []
    for number, (west, south, east, north) in enumerate((_COURTYARD, *_BUILDINGS)):
        out = -1 if number == 0 else 1
        sides += [(True, west, south, north, -out), (True, east, south, north, out)]
        sides += [(False, south, west, east, -out), (False, north, west, east, out)]
    return tuple(_Face(number, *side) for number, side in enumerate(sides))


_FACES = _faces()


def _visible_from(east_m: float, north_m: float) -> Iterator[tuple[_Face, float]]:
    """Yield the faces that are turned to a position, with the signed distance of their line from it."""
    for face in _FACES:
        distance_m = face.at_m - (east_m if face.is_x else north_m)
        if distance_m * face.outward < 0:
            yield face, distance_m


class _Pattern(NamedTuple):
    """The azimuths of the rays of a scan; `phase`: by which part of a step they are shifted, 0 to 1."""

    phase: float
    cosines: list[float]
    sines: list[float]

    @classmethod
    def of(cls, azimuths: int, phase: float) -> _Pattern:
        angles = [2 * math.pi * (number + phase) / azimuths - math.pi for number in range(azimuths)]
        return cls(phase, [math.cos(angle) for angle in angles], [math.sin(angle) for angle in angles])


class LidarView:
    """Scans of one lidar: `points` in 16 rings, all measured at the same instant; frame of the lidar, level.

    The rays have no fixed pattern: with one, a scan would match the one before best where the robot has not moved, and
    odometry by scan matching would stand still.
    """

    def __init__(self, points: int, chance: random.Random) -> None:
        self._azimuths = max(1, points // _RINGS)
        self.points = self._azimuths * _RINGS
        self._patterns = [_Pattern.of(self._azimuths, phase / _PATTERNS) for phase in range(_PATTERNS)]
        # All tables are repeated, so that a scan has its part in one piece, wherever that begins.
        self._slopes = [
            [math.tan(math.radians(low + chance.random() * (high - low))) for _ in range(_SLOPES)]
            * (2 + self._azimuths // _SLOPES)
            for low, high in pairwise(_BANDS_DEG)
        ]
        self._noise = [chance.gauss(0, _RANGE_NOISE_M) for _ in range(_NOISE_VALUES)]
        self._noise *= 2 + self._azimuths // _NOISE_VALUES
        # So many that no compressor finds one again within its window.
        self._intensities = array("f", [255 * chance.random() for _ in range(_INTENSITIES)])
        self._intensities *= 2 + self.points // _INTENSITIES

    def scan(self, number: int, state: MotionState) -> array[float]:
        """Return x, y, z and intensity of each point, in the order of the azimuths from -pi on.

        `state`: the pose of the lidar. `number`: selects the noise.
        """
        pattern = self._patterns[number * 5 % _PATTERNS]
        distances = self._distances(state, pattern)
        scan = array("f", bytes(self.points * 16))
        stride = 4 * _RINGS
        offset = number * 7919 * _RINGS
        for ring, table in enumerate(self._slopes):
            at = (offset + ring * 31) % _SLOPES
            slopes = table[at : at + self._azimuths]
            levels = distances
            if _BANDS_DEG[ring] < 0:
                height_m = -state.up_m
                levels = list(map(min, distances, [height_m / slope for slope in slopes]))
            at = (offset + ring * self._azimuths) % _NOISE_VALUES
            noise = self._noise[at : at + self._azimuths]
            levels = list(map(add, levels, noise))
            # An array is made faster from a list than from an iterator.
            scan[4 * ring :: stride] = array("f", list(map(mul, levels, pattern.cosines)))
            scan[4 * ring + 1 :: stride] = array("f", list(map(mul, levels, pattern.sines)))
            scan[4 * ring + 2 :: stride] = array("f", list(map(mul, levels, slopes)))
        at = offset % _INTENSITIES
        scan[3::4] = self._intensities[at : at + self.points]
        return scan

    def _distances(self, state: MotionState, pattern: _Pattern) -> list[float]:
        """Return the distance of the nearest wall at each azimuth, measured on the level."""
        nearest = [1 / _FARTHEST_M] * self._azimuths  # inverse distances: of a wall, they are linear in sine and cosine
        cosine, sine = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
        for face, distance_m in _visible_from(state.east_m, state.north_m):
            for low, high in self._azimuths_of(face, state, pattern.phase):
                if face.is_x:
                    by_cosine, by_sine = cosine / distance_m, -sine / distance_m
                else:
                    by_cosine, by_sine = sine / distance_m, cosine / distance_m
                pairs = zip(pattern.cosines[low:high], pattern.sines[low:high], strict=True)
                inverse = [by_cosine * x + by_sine * y for x, y in pairs]
                nearest[low:high] = map(max, nearest[low:high], inverse)
        return [1 / value for value in nearest]

    def _azimuths_of(self, face: _Face, state: MotionState, phase: float) -> list[tuple[int, int]]:
        """Return the ranges of azimuth numbers at which a face is hit, unless another one is nearer."""
        ends = []
        for along in (face.low_m, face.high_m):
            x, y = (face.at_m, along) if face.is_x else (along, face.at_m)
            ends.append(math.remainder(math.atan2(y - state.north_m, x - state.east_m) - state.yaw_rad, 2 * math.pi))
        step = 2 * math.pi / self._azimuths
        low, high = sorted((angle + math.pi) / step - phase for angle in ends)
        first, last = math.floor(low) + 1, math.floor(high) + 1
        if high - low < self._azimuths / 2:
            return [(max(0, first), min(last, self._azimuths))]
        return [(0, max(0, first)), (last, self._azimuths)]


def with_far_points(scan: array[float]) -> array[float]:
    """Return the scan with each fourth point 25 times as far away as it is."""
    distorted = array("f", scan)
    for axis in range(3):
        part = distorted[axis :: 4 * _FAR_POINTS_EVERY]
        distorted[axis :: 4 * _FAR_POINTS_EVERY] = array("f", [_FAR * value for value in part])
    return distorted


class CameraView:
    """Pictures of one pinhole camera with a horizontal field of view of 90 degrees, in tiles of brightness."""

    def __init__(self, columns: int, rows: int, chance: random.Random) -> None:
        self.columns, self.rows = columns, rows
        self._focal = columns / 2
        self._slopes = [1 - (2 * column + 1) / columns for column in range(columns)]
        self._noisy = [chance.randrange(columns * rows) for _ in range(40 * _NOISY_TILES)]
        # Of a camera one metre high, how far away the floor is in each row below the horizon.
        self._floor_depths = [self._focal / (row + 0.5 - rows / 2) for row in range(rows // 2, rows)]

    def picture(self, number: int, state: MotionState) -> bytes:
        """Return the brightness of the tiles, row by row, with the noise of picture `number`.

        `state`: the pose of the camera.
        """
        forward = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
        floor_depths = [depth * state.up_m for depth in self._floor_depths if depth * state.up_m < _FLOOR_DETAIL_M]
        inverse_depths, faces = self._nearest(state, forward)
        strips: list[bytes] = []
        for slope, inverse_depth, face in zip(self._slopes, inverse_depths, faces, strict=True):
            # The direction of the ray of this column, one metre deep.
            east, north = forward[0] - slope * forward[1], forward[1] + slope * forward[0]
            along = state.north_m + north / inverse_depth if face.is_x else state.east_m + east / inverse_depth
            stripe = math.floor(along / _STRIPE_M)
            wall = self._wall(inverse_depth, state.up_m, _WALLS[(face.number * 5 + stripe * 3) % len(_WALLS)], stripe)
            count = self.rows - len(wall)
            squares = _squares(floor_depths[-count:] if count else [], state, east, north)
            strips += (wall, bytes((_FLOOR,)) * (count - len(squares)), squares)
        pixels = b"".join(strips)
        tiles = bytearray(b"".join([pixels[row :: self.rows] for row in range(self.rows)]))
        at = number * _NOISY_TILES % len(self._noisy)
        for tile in self._noisy[at : at + _NOISY_TILES]:
            tiles[tile] ^= _NOISE_LEVEL
        return bytes(tiles)

    def _nearest(self, state: MotionState, forward: tuple[float, float]) -> tuple[list[float], list[_Face]]:
        """Return the inverse depth of the nearest wall in each column, and the wall."""
        nearest = [1 / _FARTHEST_M] * self.columns
        faces = [_FACES[0]] * self.columns
        for face, distance_m in _visible_from(state.east_m, state.north_m):
            columns = self._columns_of(face, state, forward)
            if face.is_x:
                at_centre, by_slope = forward[0] / distance_m, -forward[1] / distance_m
            else:
                at_centre, by_slope = forward[1] / distance_m, forward[0] / distance_m
            for column in columns:
                inverse_depth = at_centre + by_slope * self._slopes[column]
                if inverse_depth > nearest[column]:
                    nearest[column], faces[column] = inverse_depth, face
        return nearest, faces

    def _columns_of(self, face: _Face, state: MotionState, forward: tuple[float, float]) -> range:
        """Return the columns in which a face is seen, unless another one is nearer."""
        ends = []
        for along in (face.low_m, face.high_m):
            x, y = (face.at_m, along) if face.is_x else (along, face.at_m)
            east, north = x - state.east_m, y - state.north_m
            ends.append((east * forward[0] + north * forward[1], north * forward[0] - east * forward[1]))
        (depth, left), (other_depth, other_left) = sorted(ends)
        if other_depth <= _NEAREST_M:
            return range(0)
        if depth < _NEAREST_M:
            share = (_NEAREST_M - depth) / (other_depth - depth)
            depth, left = _NEAREST_M, left + share * (other_left - left)
        low, high = sorted(((1 - left / depth) * self._focal - 0.5, (1 - other_left / other_depth) * self._focal - 0.5))
        return range(max(0, math.ceil(low)), min(self.columns, math.floor(high) + 1))

    def _wall(self, inverse_depth: float, height_m: float, brightness: int, stripe: int) -> bytes:
        """Return the upper part of a column: sky, and a wall with bands."""
        middle, scale = self.rows / 2 + 0.5, self._focal * inverse_depth
        ends = [
            max(0, min(self.rows, int(middle + scale * (height_m - _WALL_HEIGHT_M * (1 - band / _BANDS)))))
            for band in range(_BANDS + 1)
        ]
        parts = [bytes((_SKY,)) * ends[0]]
        for band in range(_BANDS):
            change = _BAND_CONTRAST if (stripe + band) % 2 else -_BAND_CONTRAST
            parts.append(bytes((brightness + change,)) * (ends[band + 1] - ends[band]))
        return b"".join(parts)


def _squares(depths: Sequence[float], state: MotionState, east: float, north: float) -> bytes:
    """Return the pattern of the floor where a ray, whose direction is one metre deep, hits it at some depths."""
    # 100 metres are added so that all coordinates are positive.
    x, y = state.east_m + 100, state.north_m + 100
    return bytes([_FLOOR + _FLOOR_CONTRAST * (int(x + depth * east) + int(y + depth * north) & 1) for depth in depths])


def blurred(tiles: bytes, columns: int) -> bytes:
    """Return a picture out of focus: only its coarse gradients are left."""
    rows = len(tiles) // columns
    cell = max(1, columns // 4)
    coarse = [
        [_mean(tiles, columns, range(top, min(rows, top + cell)), range(left, min(columns, left + cell)))
         for left in range(0, columns, cell)]
        for top in range(0, rows, cell)
    ]  # fmt: skip
    smooth = bytearray()
    for row in range(rows):
        for column in range(columns):
            smooth.append(round(_between(coarse, row / cell - 0.5, column / cell - 0.5)))
    return bytes(smooth)


def _mean(tiles: bytes, columns: int, rows: range, cell_columns: range) -> float:
    return sum(tiles[row * columns + column] for row in rows for column in cell_columns) / len(rows) / len(cell_columns)


def _between(coarse: Sequence[Sequence[float]], row: float, column: float) -> float:
    """Return the bilinear interpolation at a place; beyond the edges, that of the edge."""
    row, column = max(0.0, min(len(coarse) - 1, row)), max(0.0, min(len(coarse[0]) - 1, column))
    top, left = int(row), int(column)
    bottom, right = min(top + 1, len(coarse) - 1), min(left + 1, len(coarse[0]) - 1)
    down, across = row - top, column - left
    upper = coarse[top][left] * (1 - across) + coarse[top][right] * across
    return upper * (1 - down) + (coarse[bottom][left] * (1 - across) + coarse[bottom][right] * across) * down
