# /// script
# requires-python = ">=3.10"
# dependencies = ["open-kleinkram[reading]"]
#
# [tool.kleinkram]
# name = "preview"
# description = "Pictures of a mission: frames of cameras, plots of numbers, top views of lidars, GNSS and odometry."
# metrics = [
#   {name = "cameras", description = "cameras with frames"},
#   {name = "lidars", description = "lidars with points"},
#   {name = "plotted_topics", description = "topics with plots of numbers"},
# ]
# resources = {cores = 2, memory = "1GB", disk = "1GB", time = "30m"}
# network = "none"
# right = "READ"
# inputs = {paths = ["*.mcap", "*.bag", "*.db3", "*.ulg", "*.zst", "*.zstd", "*metadata.yaml"]}
#
# [[tool.kleinkram.parameters]]
# name = "topics"
# type = "string"
# default = "*"
# description = "Topics that are shown: names or globs, separated by commas, such as /camera/*, /imu/*."
#
# [[tool.kleinkram.parameters]]
# name = "exclude"
# type = "string"
# default = ""
# description = "Topics that are not shown: names or globs, separated by commas."
#
# [[tool.kleinkram.parameters]]
# name = "frames"
# type = "integer"
# minimum = 1
# maximum = 60
# default = 12
# description = "Frames on the contact sheet of each camera."
#
# [[tool.kleinkram.parameters]]
# name = "max_plots"
# type = "integer"
# minimum = 0
# maximum = 120
# default = 24
# description = "Plots of numbers. With more, those of the most telling fields are made: every topic has one first."
# ///
"""Pictures by which people recognise a mission and see at a glance what is in it.

Cameras and lidars are sampled: of each, some segments (chunks) spread over the mission are read. Topics of numbers are
read whole in missions of up to `WHOLE_BYTES`; in larger ones, segments that are spread evenly. Times are log times.
"""

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kleinkram.action import context, out, parameters, progress, report
from kleinkram.action.run_files import in_dir
from kleinkram.checks.content.probe import SampleSink
from kleinkram.checks.content.sample_reader import SampleReader
from kleinkram.checks.facts import TopicFacts
from kleinkram.checks.local import LocalMission, read_mission
from kleinkram.library import pictures
from kleinkram.library.canvas import Canvas, printable
from kleinkram.library.curves import TimeSpan, TopicNumbers, most_interesting, numeric_fields, panels_of, short_type
from kleinkram.library.frames import LIDAR_TYPES, Frame, Samples, ScanPoints, read_frame, read_scan
from kleinkram.library.pictures import CameraFrames, PlanarTrack
from kleinkram.recordings import Recording, RecordingError, Topic, TopicSummary
from kleinkram.recordings.decoding.sensor_data import CAMERA_TYPES, VIDEO_TYPES
from kleinkram.recordings.model import Content, counted

WHOLE_BYTES = 1_500_000_000
SAMPLE_BYTES = 400_000_000
MAX_CAMERAS, MAX_LIDARS, MAX_TOPICS, MAX_TRACKS = 24, 8, 300, 10
SCANS = 3
PANELS_OF_PICTURE = 12
LARGE_TILE, SMALL_TILE = (640, 480), (400, 300)
MAX_TRACK_POINTS = 2000  # of track.geojson
FAR_M = 10_000  # a track that begins farther from the origin is drawn from its start
LEAST_EXTENT_M = 5  # of a track that represents a mission with lidars
SHOWN_NAMES = 20


class Options(NamedTuple):
    """The parameters of the run."""

    topics: tuple[str, ...]
    exclude: tuple[str, ...]
    frames: int
    max_plots: int

    def selects(self, topic: str) -> bool:
        """Return whether a topic is shown."""
        return _matches(topic, self.topics) and not _matches(topic, self.exclude)


def _matches(topic: str, patterns: Sequence[str]) -> bool:
    return any(topic == pattern or fnmatchcase(topic, pattern) for pattern in patterns)


def patterns_in(text: str) -> tuple[str, ...]:
    """Return the names and globs of a list that commas separate."""
    return tuple(filter(None, (part.strip() for part in text.split(","))))


def main() -> None:
    """Read the mission, draw it, and report what is not shown."""
    progress(0.0, "Reading the indexes")
    values = parameters()
    options = Options(
        patterns_in(str(values["topics"])),
        patterns_in(str(values["exclude"])),
        int(values["frames"]),
        int(values["max_plots"]),
    )
    mission = read_mission({file.path: in_dir / file.path for file in context().files})
    report_unreadable(mission)
    if mission.facts.start_ns is None or mission.facts.end_ns is None:
        reason = "its recordings have no messages" if mission.recordings else "it has no recordings"
        note("info", "mission.empty", f"There is nothing to show of the mission: {reason}.")
        return
    collected = Collected(options, TimeSpan(mission.facts.start_ns, mission.facts.end_ns), _camera_count(mission))
    read_recordings(mission, collected)
    collected.report_left_out()
    progress(0.7, "Drawing")
    Pages(mission, collected).draw()


def note(severity: str, code: str, message: str, topic: str | None = None) -> None:
    """Report a finding. Names in recordings may have any character."""
    report.finding(
        severity, code, printable(message)[:1900], topic=(printable(topic)[:1000] or None) if topic else None
    )


def report_unreadable(mission: LocalMission) -> None:
    """Report recordings that are damaged, or cannot be read at all."""
    for recording in mission.recordings:
        if recording.content is Content.recovered:
            note(
                "warning",
                "recording.damaged",
                f"{recording.name} is damaged, and shown as far as it can be read: {recording.reason}",
            )
        elif recording.content is not Content.indexed:
            note("warning", "recording.unreadable", f"{recording.name} cannot be read: {recording.reason}")


def _camera_count(mission: LocalMission) -> int:
    return sum(short_type(topic.message_type or "") in CAMERA_TYPES for topic in mission.facts.topics)


# -- reading ----------------------------------------------------------------------------------------------------------


class Collected:
    """What was read of the topics of a mission, over all its recordings, and why topics are left out."""

    def __init__(self, options: Options, span: TimeSpan, camera_count: int) -> None:
        self.options = options
        self.span = span
        self.cameras: dict[str, Samples[Frame]] = {}
        self.lidars: dict[str, Samples[ScanPoints]] = {}
        self.numbers: dict[str, TopicNumbers] = {}
        self.share = 1.0
        self._is_any_selected = False
        self._tile = LARGE_TILE if camera_count <= 2 else SMALL_TILE
        self._left_out: dict[str, dict[str, None]] = defaultdict(dict)

    def plan(self, topics: Sequence[Topic]) -> None:
        """Decide how each topic of a recording is shown."""
        for topic in topics:
            if self.options.selects(topic.name):
                self._is_any_selected = True
                self._plan(topic)

    def _plan(self, topic: Topic) -> None:
        name, kind = topic.name, short_type(topic.message_type)
        if topic.count == 0:
            self.leave_out("they have no messages", [name])
        elif topic.undecodable is not None:
            note(
                "info",
                "topic.undecodable",
                f"{name} is not shown, because its messages cannot be decoded: {topic.undecodable}",
                name,
            )
        elif kind in CAMERA_TYPES:
            if len(self.cameras) < MAX_CAMERAS or name in self.cameras:
                read = partial(read_frame, self._tile)
                self.cameras.setdefault(name, Samples(read, 4 * self.options.frames))
            else:
                self.leave_out(f"only {MAX_CAMERAS} cameras are shown", [name])
        elif kind in VIDEO_TYPES:
            self.leave_out("frames of videos are not decoded", [name])
        elif kind in LIDAR_TYPES:
            if len(self.lidars) < MAX_LIDARS or name in self.lidars:
                self.lidars.setdefault(name, Samples(read_scan, 4 * SCANS))
            else:
                self.leave_out(f"only {MAX_LIDARS} lidars are shown", [name])
        else:
            self._plan_numbers(topic)

    def _plan_numbers(self, topic: Topic) -> None:
        if topic.name in self.numbers:
            return
        if numeric_fields(topic) == []:
            self.leave_out("their messages have no numbers to plot over time", [topic.name])
        elif len(self.numbers) >= MAX_TOPICS:
            self.leave_out(f"only {MAX_TOPICS} topics of numbers are read", [topic.name])
        else:
            self.numbers[topic.name] = TopicNumbers(topic.name, topic.message_type, self.span)

    def leave_out(self, reason: str, topics: Sequence[str]) -> None:
        """Note why topics are not shown; one finding names all topics of a reason."""
        self._left_out[reason].update(dict.fromkeys(topics))

    def report_left_out(self) -> None:
        """Report the topics that are not shown, and the messages of others that could not be."""
        if not self._is_any_selected:
            note("info", "topics.not_shown", "The parameters `topics` and `exclude` select no topic of the mission.")
        for what, samples in (("frames", self.cameras), ("scans", self.lidars)):
            for topic, collected in samples.items():
                total = collected.failed + len(collected.items)
                if collected.failed:
                    message = f"{collected.failed} of {total} {what} that were read cannot be shown: {collected.error}"
                    note("info", f"{what}.unreadable", f"{topic}: {message}", topic)
                elif not total:
                    note("info", f"{what}.missing", f"{topic}: no {what} were read: {collected.error}", topic)
        for topic, numbers in self.numbers.items():
            if numbers.failed:
                message = f"{numbers.failed} messages cannot be decoded: {numbers.error}"
                note("info", "topic.undecodable", f"{topic}: {message}", topic)
            if numbers.track is not None and numbers.track.unusable:
                total = numbers.track.unusable + numbers.track.count
                what = "without fix or " if numbers.track.is_gnss else ""
                message = f"{numbers.track.unusable} of {total} positions are {what}invalid, and left out of the track"
                note("info", "positions.unusable", f"{topic}: {message}", topic)
            if not panels_of(numbers):
                self.leave_out("their messages have no numbers to plot over time", [topic])
        for reason, topics in self._left_out.items():
            note(
                "info",
                "topics.not_shown",
                f"{counted_names(list(topics), 'topic')} not shown, because {reason}: {shown_names(list(topics))}",
            )


def counted_names(names: Sequence[str], noun: str) -> str:
    """Return `1 topic is` or `2 topics are`."""
    return f"1 {noun} is" if len(names) == 1 else f"{len(names)} {noun}s are"


def shown_names(names: Sequence[str]) -> str:
    """Return the first names, and how many there are more."""
    more = f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else ""
    return ", ".join(names[:SHOWN_NAMES]) + more


def read_recordings(mission: LocalMission, collected: Collected) -> None:
    """Read all recordings, one after the other. One that cannot be read becomes a finding."""
    readable = [one for one in mission.recordings if one.content in (Content.indexed, Content.recovered)]
    total_bytes = sum(path.stat().st_size for one in readable for path in one.members)
    collected.share = min(1.0, WHOLE_BYTES / max(1, total_bytes))
    for number, recording in enumerate(readable):
        progress(0.05 + 0.65 * number / len(readable), f"Reading {printable(recording.name)[:150]}")
        try:
            with recording.open() as reader:
                collected.plan(reader.topics)
                read_samples(recording.name, reader, collected)
                read_numbers(reader, collected)
                if reader.damage and recording.content is Content.indexed:
                    first = reader.damage[0]
                    message = f"damaged parts were left out: {len(reader.damage)}"
                    note(
                        "warning",
                        "recording.damaged",
                        f"{recording.name}: {message}; the first: {first.where}: {first.message}",
                    )
        except RecordingError as error:
            note("warning", "recording.unreadable", f"{recording.name} cannot be read further: {error}")
    for numbers in collected.numbers.values():
        numbers.finish()


def read_samples(name: str, reader: Recording, collected: Collected) -> None:
    """Read frames and scans that are spread over a recording."""
    topics = {topic.name for topic in reader.topics if topic.count != 0}
    sinks: dict[str, list[SampleSink]] = {}
    needed: dict[str, int] = {}
    for samples, count in ((collected.cameras, collected.options.frames), (collected.lidars, SCANS)):
        for topic in sorted(topics.intersection(samples)):
            sinks[topic], needed[topic] = [samples[topic]], count
    if needed:
        SampleReader(name, reader, needed, 0).read(sinks, SAMPLE_BYTES)


def read_numbers(reader: Recording, collected: Collected) -> None:
    """Read the topics of numbers: whole, or as large a share of the segments as `collected` says."""
    names = [topic.name for topic in reader.topics if topic.name in collected.numbers]
    if not names:
        return
    if collected.share >= 1:
        for message in reader.raw_messages(names):
            collected.numbers[message.topic].add(message)
        return
    segments = reader.segments(names)
    count = max(min(2, len(segments)), int(collected.share * len(segments)))
    for place in spread(len(segments), count):
        for block in reader.segment_messages(segments[place], names):
            for message in block:
                collected.numbers[message.topic].add(message)


# -- drawing ----------------------------------------------------------------------------------------------------------


class Pages:
    """The pictures of a mission, which are reported in the order in which they are drawn."""

    def __init__(self, mission: LocalMission, collected: Collected) -> None:
        self._collected = collected
        self._span = collected.span
        self._facts = {topic.name: topic for topic in mission.facts.topics}
        self._present_s: dict[str, list[tuple[float, float]]] = defaultdict(list)
        for summary in mission.summaries.values():
            for topic in summary.topics:
                self._present_s[topic.name] += present_times(topic, self._span)
        self._views = sorted(self._camera_views(), key=lambda view: view.topic)
        self._scans = {
            topic: [samples.items[place] for place in spread(len(samples.items), SCANS)]
            for topic, samples in sorted(collected.lidars.items())
            if samples.items
        }
        all_panels = [panel for numbers in collected.numbers.values() for panel in panels_of(numbers)]
        self._panels = most_interesting(all_panels, collected.options.max_plots)
        self._left_out = [panel for panel in all_panels if panel not in self._panels]
        self._gnss, self._poses = self._tracks(is_gnss=True), self._tracks(is_gnss=False)

    def draw(self) -> None:
        """Draw and report all pictures and metrics."""
        self._publish(self._overview(), "overview.jpg", "Overview", pictures.MAX_OVERVIEW_BYTES)
        self._draw_cameras()
        self._draw_plots()
        self._draw_lidars()
        self._draw_tracks()
        report.metric("cameras", len(self._views))
        report.metric("lidars", len(self._scans))
        report.metric("plotted_topics", len({panel.topic for panel in self._panels}))

    def _publish(self, canvas: Canvas, name: str, title: str, max_bytes: int | None = None) -> None:
        canvas.save(out / name, max_bytes)
        report.preview(out / name, printable(title)[:200])

    def _overview(self) -> Canvas:
        """Return a picture for lists: of cameras, or of whatever else there is."""
        if self._views:
            return pictures.camera_overview(sorted(self._views, key=view_rank))
        gnss, poses = (self._gnss, "GNSS track", ("east", "north")), (self._poses, "Odometry and poses", ("x", "y"))
        for tracks, title, axes in (gnss, poses):
            if tracks and (extent_m(tracks) >= LEAST_EXTENT_M or not self._scans):
                return pictures.track_map(tracks, title, axes, pictures.OVERVIEW)
        if self._scans:
            scans = max(self._scans.values(), key=lambda own: max(scan.total for scan in own))
            return pictures.lidar_overview(scans[len(scans) // 2])
        if self._panels:
            return pictures.plot_overview(self._panels, self._span)
        return pictures.message_bars(sorted(self._present_s.items()), self._span)

    def _camera_views(self) -> Iterator[CameraFrames]:
        for topic, samples in self._collected.cameras.items():
            frames = sorted(samples.items, key=lambda frame: frame.time_ns)
            frames = [frames[place] for place in spread(len(frames), self._collected.options.frames)]
            if frames:
                size = f"{frames[0].size[0]} × {frames[0].size[1]}"
                details = self._details(topic, size, frames[0].encoding[:60])
                yield CameraFrames(topic, details, tuple(frames), tuple(self._present_s[topic]))

    def _details(self, topic: str, *others: str) -> str:
        """Return type, rate and number of messages of a topic, as far as they are known, as one line."""
        facts = self._facts.get(topic) or TopicFacts(topic, None, None)
        rate = f"{facts.rate_hz:.3g} Hz" if facts.rate_hz else ""
        count = "" if facts.count is None else counted(facts.count, "message")
        return " · ".join(filter(None, (facts.message_type, *others, rate, count)))

    def _draw_cameras(self) -> None:
        for number, view in enumerate(self._views, 1):
            progress(0.7 + 0.15 * number / len(self._views), "Drawing contact sheets")
            name = f"camera-{number:02}{file_name_part(view.topic)}.jpg"
            self._publish(pictures.contact_sheet(view, self._span), name, f"{view.topic} · {view.details}")
        if self._views:
            strip = pictures.camera_strip(self._views, self._span)
            self._publish(strip, "cameras-over-time.jpg", "All cameras over time; red: no frames")

    def _draw_plots(self) -> None:
        share = self._collected.share
        part = "" if share == 1 else f", from {share:.0%} of the data, spread evenly"
        title = f"Numbers over time: least and greatest value of each interval{part}"
        pages = [
            self._panels[begin : begin + PANELS_OF_PICTURE] for begin in range(0, len(self._panels), PANELS_OF_PICTURE)
        ]
        for number, panels in enumerate(pages, 1):
            suffix = f" ({number} of {len(pages)})" if len(pages) > 1 else ""
            self._publish(pictures.plots(panels, self._span, title + suffix), f"plots-{number}.png", title + suffix)
        if self._left_out:
            names = [f"{panel.topic} {panel.field}" for panel in self._left_out]
            limit = self._collected.options.max_plots
            message = f"{counted_names(names, 'plot')} left out, because at most {limit} are made (max_plots)"
            note("info", "plots.left_out", f"{message}: {shown_names(names)}")

    def _draw_lidars(self) -> None:
        for number, (topic, scans) in enumerate(self._scans.items(), 1):
            canvas = pictures.top_views(topic, self._details(topic), scans, self._span)
            self._publish(canvas, f"lidar-{number}{file_name_part(topic)}.png", f"{topic} from above, in metres")

    def _tracks(self, *, is_gnss: bool) -> list[PlanarTrack]:
        """Return tracks in metres: GNSS east and north of the first position, others in their own frames."""
        tracks = [
            (topic, numbers.track)
            for topic, numbers in sorted(self._collected.numbers.items())
            if numbers.track is not None and numbers.track.is_gnss is is_gnss and numbers.track.count
        ][:MAX_TRACKS]
        drawn = []
        for topic, track in tracks:
            origin = tracks[0][1].rows[0]
            xy = track.metres((float(origin[1]), float(origin[2])))
            is_far = not is_gnss and float(np.abs(xy[0]).max()) > FAR_M
            drawn.append(PlanarTrack(f"{topic} (from its start)" if is_far else topic, xy - xy[0] if is_far else xy))
        return drawn

    def _draw_tracks(self) -> None:
        if self._gnss:
            canvas = pictures.track_map(self._gnss, "GNSS track, in metres from its start", ("east", "north"))
            self._publish(canvas, "track-gnss.png", "GNSS track, in metres from its start")
            path = out / "track.geojson"
            path.write_text(json.dumps(geojson(self._collected.numbers)))
            report.preview(path, "GNSS track (WGS 84)")
        if self._poses:
            title = "Odometry and poses, each in its own frame"
            self._publish(pictures.track_map(self._poses, title, ("x", "y")), "track-odometry.png", title)


def spread(count: int, limit: int) -> list[int]:
    """Return at most `limit` of the numbers below `count`, evenly spread, the first and the last among them."""
    if count <= limit:
        return list(range(count))
    if limit == 1:
        return [count // 2]
    return [round(number * (count - 1) / (limit - 1)) for number in range(limit)]


def extent_m(tracks: Sequence[PlanarTrack]) -> float:
    """Return how large an area the tracks cover, along x or y."""
    low, high = pictures.track_bounds(tracks)
    return float((high - low).max())


def view_rank(view: CameraFrames) -> tuple[bool, int, str]:
    """Return by what cameras are chosen for the overview: with contrast first, colour before grey before depth."""
    shown = view.pictures()
    has_contrast = max(float(picture.std()) for picture in shown) > 4
    if any(frame.is_depth for frame in view.frames):
        return not has_contrast, 2, view.topic
    is_grey = all(bool((picture == picture[..., :1]).all()) for picture in shown)
    return not has_contrast, int(is_grey), view.topic


def file_name_part(topic: str) -> str:
    """Return a topic as the end of a file's name."""
    text = re.sub(r"[^A-Za-z0-9]+", "-", topic).strip("-")[:60].strip("-")
    return f"-{text}" if text else ""


def present_times(topic: TopicSummary, span: TimeSpan) -> list[tuple[float, float]]:
    """Return when a topic has messages, in seconds of the mission: silence of three usual intervals is a gap."""
    if topic.first_ns is None or topic.last_ns is None:
        return []
    density = topic.density
    if density is None:
        return [((topic.first_ns - span.start_ns) / 1e9, (topic.last_ns - span.start_ns) / 1e9)]
    used = np.flatnonzero(np.array(density.counts))
    allowed_ns = max(1.5 * density.bin_ns, 3e9 / topic.rate_hz if topic.rate_hz else 0)
    runs = np.split(used, np.flatnonzero(np.diff(used) * density.bin_ns > allowed_ns) + 1)
    begin_s = (density.start_ns - span.start_ns) / 1e9
    bin_s, allowed_s = density.bin_ns / 1e9, allowed_ns / 1e9
    present = []
    for run in runs:
        first_s, last_s = begin_s + int(run[0]) * bin_s, begin_s + (int(run[-1]) + 1) * bin_s
        is_at_end = last_s >= span.seconds - allowed_s
        present.append((0.0 if first_s <= allowed_s else first_s, span.seconds if is_at_end else last_s))
    return present


def geojson(numbers: Mapping[str, TopicNumbers]) -> dict[str, object]:
    """Return the GNSS tracks as a collection of features in WGS 84 (RFC 7946), thinned."""
    features = []
    for topic, collected in sorted(numbers.items()):
        if collected.track is None or not collected.track.is_gnss or not collected.track.count:
            continue
        degrees: NDArray[np.float64] = collected.track.rows[:, 1:]
        coordinates = [
            [round(float(value), 7) for value in degrees[place]] for place in spread(len(degrees), MAX_TRACK_POINTS)
        ]
        geometry: dict[str, object] = {"type": "LineString", "coordinates": coordinates}
        if len(coordinates) == 1:
            geometry = {"type": "Point", "coordinates": coordinates[0]}
        properties = {"topic": printable(topic), "positions": collected.track.count}
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    return {"type": "FeatureCollection", "features": features}


if __name__ == "__main__":
    main()
