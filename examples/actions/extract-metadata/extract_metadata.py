# /// script
# requires-python = ">=3.10"
# dependencies = ["open-kleinkram"]
#
# [tool.kleinkram]
# name = "extract-metadata"
# description = "Duration, distance, area and sensors of a mission, and its track as GeoJSON and as a picture."
# inputs = {paths = ["*.bag", "*.mcap", "*.db3", "*.mcap.zst*", "*.db3.zst*", "*metadata.yaml"]}
# resources = {cores = 1, memory = "1GB", disk = "1GB", time = "2h"}
#
# [[tool.kleinkram.parameters]]
# name = "topic"
# type = "topic"
# default = ""
# description = "The topic of the positions; by default odometry, then GPS, then poses."
#
# [[tool.kleinkram.parameters]]
# name = "gps_step"
# type = "number"
# unit = "m"
# default = 1.0
# minimum = 0
# description = "Shorter moves between fixes count as noise of the receiver."
#
# [[tool.kleinkram.parameters]]
# name = "fastest"
# type = "number"
# unit = "m/s"
# default = 100.0
# minimum = 0
# description = "Faster moves are jumps of the estimate: they are reported and not counted."
# ///
"""Duration, distance, area and sensors of a mission, and its track as GeoJSON and as a picture.

Positions come from nav_msgs/Odometry, sensor_msgs/NavSatFix (WGS 84, without messages that have no fix), or
geometry_msgs/PoseStamped. The distance is the sum of the moves between positions. Recordings that overlap in time count
as one drive, with the longest distance. Transforms (/tf) are not read, because they do not name the robot's frame.
"""

import csv
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from kleinkram.action import context, inputs, out, parameters, progress, report
from kleinkram.action.run_files import in_dir
from kleinkram.recordings import FileSource, Message, NotARecording, Recording, RecordingGroup, group

NS = 10**9
MOST_POINTS = 5000
MOST_JUMPS = 20
NO_FIX = -1  # sensor_msgs/NavSatStatus, STATUS_NO_FIX
# Source: NIMA TR8350.2, table 3.1: semi-major axis in metres, and flattening, of WGS 84.
WGS84_A = 6_378_137.0
WGS84_F = 1 / 298.257223563

# In the order in which they are preferred.
KINDS = {"Odometry": "odometry", "NavSatFix": "gps", "PoseStamped": "pose"}
SENSORS = {
    "BatteryState": "battery",
    "CameraInfo": "camera",
    "CompressedImage": "camera",
    "FluidPressure": "barometer",
    "Image": "camera",
    "Imu": "imu",
    "JointState": "joint encoders",
    "LaserScan": "lidar",
    "MagneticField": "magnetometer",
    "MultiEchoLaserScan": "lidar",
    "NavSatFix": "gps",
    "PointCloud2": "lidar",
    "Range": "range finder",
    "Temperature": "thermometer",
}


class Point(NamedTuple):
    """Log time in ns, and a position: metres in the topic's frame, or longitude and latitude in degrees, and metres."""

    time_ns: int
    x: float
    y: float
    z: float


@dataclass
class Track:
    """The positions of one topic: the distance, and a bounded number of evenly spaced points."""

    recording: str
    topic: str
    kind: str
    frame: str = ""
    count: int = 0
    no_fix: int = 0
    distance_m: float = 0.0
    jumps: list[tuple[int, float]] = field(default_factory=list)
    low: list[float] = field(default_factory=lambda: [math.inf] * 3)
    high: list[float] = field(default_factory=lambda: [-math.inf] * 3)
    points: list[Point] = field(default_factory=list)
    last: Point | None = None
    _counted: Point | None = None
    _stride: int = 1

    def add(self, point: Point, shortest_m: float, fastest_m_s: float) -> None:
        """Add the next position."""
        self.low = [min(pair) for pair in zip(self.low, point[1:], strict=True)]
        self.high = [max(pair) for pair in zip(self.high, point[1:], strict=True)]
        self._measure(point, shortest_m if self.kind == "gps" else 0.0, fastest_m_s)
        if self.count % self._stride == 0:
            self.points.append(point)
        if len(self.points) > MOST_POINTS:
            self.points, self._stride = self.points[::2], self._stride * 2
        self.count += 1
        self.last = point

    def _measure(self, point: Point, shortest_m: float, fastest_m_s: float) -> None:
        if self._counted is None or self.last is None:
            self._counted = point
            return
        moved_m = self._between(self._counted, point)
        if moved_m < shortest_m:
            return
        elapsed_s = (point.time_ns - self.last.time_ns) / NS
        if self._between(self.last, point) > max(fastest_m_s * elapsed_s, 1.0):
            self.jumps.append((point.time_ns, moved_m))
        else:
            self.distance_m += moved_m
        self._counted = point

    def _between(self, one: Point, other: Point) -> float:
        return math.dist(earth_fixed(one), earth_fixed(other)) if self.kind == "gps" else math.dist(one[1:], other[1:])

    def line(self) -> list[Point]:
        """Return the stored points, and the last one."""
        return [*self.points, *([self.last] if self.last and self.last != self.points[-1] else [])]


def earth_fixed(point: Point) -> tuple[float, float, float]:
    """Return metres in the earth-fixed frame, on the ellipsoid: the altitude of GPS is too coarse to add up.

    The straight line between two such points is shorter than the way over ground by less than 1 mm on a kilometre.
    """
    longitude, latitude = math.radians(point.x), math.radians(point.y)
    squared = WGS84_F * (2 - WGS84_F)
    normal = WGS84_A / math.sqrt(1 - squared * math.sin(latitude) ** 2)
    across = normal * math.cos(latitude)
    return (
        across * math.cos(longitude),
        across * math.sin(longitude),
        normal * (1 - squared) * math.sin(latitude),
    )


def position(kind: str, message: Message) -> Point | None:
    """Return the position in a message, if it has one."""
    value: Any = message.value  # of whatever type the recording itself defines
    if kind == "gps":
        if value.status.status <= NO_FIX:
            return None
        altitude = value.altitude if math.isfinite(value.altitude) else 0.0
        place = (value.longitude, value.latitude, altitude)
    else:
        pose = value.pose.pose if kind == "odometry" else value.pose
        place = (pose.position.x, pose.position.y, pose.position.z)
    return Point(message.log_time_ns, *map(float, place)) if all(map(math.isfinite, place)) else None


@dataclass(frozen=True)
class Seen:
    """The results of one recording."""

    name: str
    file: Path | None
    start_ns: int
    end_ns: int
    sensors: set[str]
    tracks: list[Track]

    def best(self) -> Track | None:
        """Return the track that counts: of the preferred kind, the one with the most positions."""
        moving = [track for track in self.tracks if track.count > 1]
        order = list(KINDS.values())
        return min(moving, key=lambda track: (order.index(track.kind), -track.count), default=None)


def opened(group: RecordingGroup, stack: ExitStack) -> Recording:
    """Open a recording of the inputs, which may have several files."""
    paths = [in_dir / path for path in (group.metadata_path, *group.members) if path is not None]
    if group.metadata_path is not None and "/" in group.metadata_path:
        return stack.enter_context(Recording.open(paths[0].parent))
    if len(paths) == 1:
        return stack.enter_context(Recording.open(paths[0]))
    return stack.enter_context(Recording.open([stack.enter_context(FileSource(path)) for path in paths]))


def look(group: RecordingGroup, share: tuple[float, float]) -> Seen | None:
    """Read one recording; None if it is empty."""
    name, (begin, width) = group.name, share
    chosen = str(parameters()["topic"])
    shortest_m, fastest_m_s = float(parameters()["gps_step"]), float(parameters()["fastest"])
    with ExitStack() as stack:
        recording = opened(group, stack)
        types = {topic.name: (topic.message_type or "").rpartition("/")[2] for topic in recording.topics}
        sensors = {SENSORS[kind] for kind in types.values() if kind in SENSORS}
        if recording.start_ns is None or recording.end_ns is None:
            return None
        tracks = {
            topic: Track(name, topic, KINDS[kind])
            for topic, kind in types.items()
            if kind in KINDS and chosen in {"", topic}
        }
        span_ns, reported = max(recording.end_ns - recording.start_ns, 1), 0.0
        for message in recording.messages([*tracks]) if tracks else ():
            track = tracks[message.topic]
            if isinstance(message.value, bytes):
                continue  # it does not fit its own definition
            track.frame = message.value.header.frame_id  # type: ignore[attr-defined]  # as in `position`
            place = position(track.kind, message)
            if place is None:
                track.no_fix += 1
            else:
                track.add(place, shortest_m, fastest_m_s)
            done = (message.log_time_ns - recording.start_ns) / span_ns
            if done > reported + 0.05:
                reported = done
                progress(min(begin + width * done, 1.0), name)
        file = in_dir / group.members[0] if len(group.members) == 1 else None
        return Seen(name, file, recording.start_ns, recording.end_ns, sensors, [*tracks.values()])


def drives(recordings: Iterable[Seen]) -> Iterator[list[Seen]]:
    """Yield groups of recordings that overlap in time."""
    together: list[Seen] = []
    for seen in sorted(recordings, key=lambda seen: seen.start_ns):
        if together and seen.start_ns > max(earlier.end_ns for earlier in together):
            yield together
            together = []
        together.append(seen)
    if together:
        yield together


def report_recording(seen: Seen) -> None:
    """Report the metrics and findings of one recording."""
    best = seen.best()
    if best is None:
        report.finding("info", "track.none", f"{seen.name} has no positions that can be read", file=seen.file)
    elif seen.file is not None:
        report.metric("distance", best.distance_m, unit="m", file=seen.file)
    for track in seen.tracks:
        if track.no_fix:
            what = f"{track.no_fix} of {track.no_fix + track.count} messages have no fix"
            report.finding("info", "track.no_fix", what, file=seen.file, topic=track.topic)
        for time_ns, moved_m in track.jumps[:MOST_JUMPS]:
            what = f"jumps by {moved_m:.1f} m, which is not counted"
            report.finding("warning", "track.jump", what, file=seen.file, topic=track.topic, time_ns=time_ns)


def area(tracks: Sequence[Track]) -> dict[str, float | str]:
    """Return the box around tracks: degrees for GPS, else metres in their frame."""
    low = [min(track.low[axis] for track in tracks) for axis in range(3)]
    high = [max(track.high[axis] for track in tracks) for axis in range(3)]
    if tracks[0].kind == "gps":
        return {"west": low[0], "south": low[1], "east": high[0], "north": high[1]}
    box = {
        f"{axis}_{end}": round(values[at], 3)
        for at, axis in enumerate("xyz")
        for end, values in (("min", low), ("max", high))
    }
    return {"frame": tracks[0].frame, **box}


def write_geojson(path: Path, tracks: Iterable[Track]) -> None:
    """Write tracks as lines of degrees.

    Source: RFC 7946, section 3.1.4.
    """
    features = [
        {
            "type": "Feature",
            "geometry": {
                "type": "LineString",
                "coordinates": [[round(p.x, 8), round(p.y, 8), round(p.z, 3)] for p in track.line()],
            },
            "properties": {
                "recording": track.recording,
                "topic": track.topic,
                "start_ns": track.points[0].time_ns,
                "distance_m": round(track.distance_m, 3),
            },
        }
        for track in tracks
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))


def write_csv(path: Path, tracks: Iterable[Track]) -> None:
    """Write tracks without geographic coordinates as a table."""
    with path.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["recording", "topic", "frame", "time_ns", "x_m", "y_m", "z_m"])
        for track in tracks:
            table.writerows([track.recording, track.topic, track.frame, *point] for point in track.line())


def metres(tracks: Sequence[Track]) -> list[list[tuple[float, float]]]:
    """Return the lines of tracks in metres: relative to their first point for GPS, else unchanged."""
    if tracks[0].kind != "gps":
        return [[(point.x, point.y) for point in track.line()] for track in tracks]
    first = tracks[0].points[0]
    north = math.radians(1) * WGS84_A
    east = north * math.cos(math.radians(first.y))
    return [[((p.x - first.x) * east, (p.y - first.y) * north) for p in track.line()] for track in tracks]


def draw(tracks: Sequence[Track]) -> Path:
    """Draw tracks as a PNG, or as an SVG without matplotlib, and return the file."""
    lines, labels = metres(tracks), [f"{track.recording} {track.topic}" for track in tracks]
    names = ("east [m]", "north [m]") if tracks[0].kind == "gps" else ("x [m]", "y [m]")
    try:
        import matplotlib as mpl
    except ImportError:
        path = out / "track.svg"
        path.write_text(svg(lines, labels, names))
        return path
    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 7), layout="constrained")
    for line, label in zip(lines, labels, strict=True):
        axes.plot(*zip(*line, strict=True), label=label, linewidth=1.2)
    axes.set(xlabel=names[0], ylabel=names[1], aspect="equal")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(out / "track.png", dpi=110)
    return out / "track.png"


def svg(lines: Sequence[Sequence[tuple[float, float]]], labels: Sequence[str], names: tuple[str, str]) -> str:
    """Return lines as a picture of 640 by 640, with its size in metres on the edges."""
    every = [point for line in lines for point in line]
    (west, east), (south, north) = ((min(axis), max(axis)) for axis in zip(*every, strict=True))
    scale = 560 / max(east - west, north - south, 0.001)
    colours = ["#0b6bcb", "#c4412a", "#2f7d32", "#8a3ffc", "#9a6700"]
    drawn = []
    for at, (line, label) in enumerate(zip(lines, labels, strict=True)):
        places = " ".join(f"{40 + (x - west) * scale:.1f},{600 - (y - south) * scale:.1f}" for x, y in line)
        colour = colours[at % len(colours)]
        words = label.replace("&", "&amp;").replace("<", "&lt;")
        drawn.append(f'<polyline points="{places}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        drawn.append(f'<text x="40" y="{16 * at + 20}" fill="{colour}">{words}</text>')
    size = f"{names[0]} {west:.0f} to {east:.0f}, {names[1]} {south:.0f} to {north:.0f}"
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 640" font-family="sans-serif" font-size="12">'
        f'<rect width="640" height="640" fill="#fff"/>{"".join(drawn)}<text x="40" y="630">{size}</text></svg>\n'
    )


def write_tracks(recordings: Iterable[Seen]) -> dict[str, Any]:
    """Write the tracks of GPS, or else those in the robot's frame; return the area."""
    tracks = [track for seen in recordings for track in seen.tracks if track.kind == "gps" and track.count > 1]
    on_earth = bool(tracks)
    tracks = tracks or [best for seen in recordings if (best := seen.best())]
    if not tracks:
        return {}
    table = out / ("track.geojson" if on_earth else "track.csv")
    (write_geojson if on_earth else write_csv)(table, tracks)
    report.preview(table, "Track")
    if not on_earth:  # what each recording calls its origin is another place
        tracks = [max(tracks, key=lambda track: track.distance_m)]
    report.preview(draw(tracks), "Track")
    place: dict[str, Any] = {"bounding_box": area(tracks)}
    if on_earth:
        first = min((track.points[0] for track in tracks), key=lambda point: point.time_ns)
        place["location"] = {"latitude": first.y, "longitude": first.x, "altitude": first.z}
    return place


def main() -> None:
    """Read all recordings of the mission, and report the results."""
    recordings: list[Seen] = []
    paths = [path.relative_to(in_dir).as_posix() for path in inputs()]
    groups = [candidate for candidate in group(paths) if candidate.members]
    for number, recording_group in enumerate(groups):
        progress(number / len(groups), recording_group.name)
        try:
            seen = look(recording_group, (number / len(groups), 1 / len(groups)))
        except NotARecording as error:
            report.finding("error", "recording.unreadable", str(error), file=in_dir / recording_group.members[0])
            continue
        if seen is None:
            continue
        print(f"{seen.name}: {(seen.end_ns - seen.start_ns) / NS:.1f} s, {len(seen.tracks)} tracks", flush=True)
        recordings.append(seen)
        report_recording(seen)
    if not recordings:
        report.finding("warning", "mission.empty", f"no recording of {context().mission.name} holds messages")
        return
    views = [*drives(recordings)]
    duration_s = sum(max(e.end_ns for e in view) - min(e.start_ns for e in view) for view in views) / NS
    report.metric("mission_duration", duration_s, unit="s")
    facts: dict[str, Any] = {"duration_s": round(duration_s, 3)}
    facts["sensors"] = sorted({sensor for seen in recordings for sensor in seen.sensors})
    best = [[track.distance_m for seen in view if (track := seen.best())] for view in views]
    if any(best):
        distance_m = sum(max(view) for view in best if view)
        report.metric("mission_distance", distance_m, unit="m")
        facts["distance_m"] = round(distance_m, 3)
    report.propose(**facts, **write_tracks(recordings))


if __name__ == "__main__":
    main()
