"""`klein inspect` and `klein sample`: local recordings, without a server."""

import contextlib
import enum
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from kleinkram.cli.commands import Many, Text, argument, flag, option
from kleinkram.cli.errors import ExitCode, Interrupted
from kleinkram.cli.render import Output, details, line, note, table
from kleinkram.cli.units import count, duration, instant, parse_size, rate, size, span
from kleinkram.client.errors import InvalidInput
from kleinkram.recordings.inspect import Inspection, ScanProgress, inspect_paths, to_plain
from kleinkram.recordings.model import Content, Depth, Lost, RecordingFormat, RecordingSummary

if TYPE_CHECKING:
    from kleinkram.cli.transfer import ProgressBars
    from kleinkram.recordings.sample import MissionTruth

_CONTENTS = {
    Content.indexed: "complete",
    Content.recovered: "damaged, read as far as possible",
    Content.broken: "nothing in it can be read",
    Content.pending: "not read yet",
    Content.opaque: "not a recording",
    Content.error: "could not be read",
}


class Rig(str, enum.Enum):
    """A robot whose sample missions can be made."""

    vehicle = "vehicle"
    legged = "legged"


@contextlib.contextmanager
def watching(deep: bool) -> Iterator[ScanProgress | None]:
    """Show a bar for each file that is scanned."""
    if not deep or not sys.stderr.isatty():
        yield None
        return
    from kleinkram.cli.transfer import ProgressBars  # slow to import

    bars = ProgressBars()
    with bars.progress:
        yield _ScanBar(bars)


class _ScanBar:
    """The bar of the file that is being read."""

    def __init__(self, bars: "ProgressBars") -> None:
        self._bars = bars
        self._path, self._size_bytes = "", 0

    def began(self, path: str, size_bytes: int) -> None:
        self._path, self._size_bytes = path, size_bytes
        self.moved(0)

    def moved(self, size_bytes: int) -> None:
        self._bars.moved(self._path, size_bytes, self._size_bytes)

    def ended(self) -> None:
        self._bars.ended(self._path, "", None)


def inspect(
    paths: Annotated[list[str], argument("PATH", "Files and folders.")],
    deep: Annotated[bool, flag("--deep", "Read every byte: check all checksums, recover what is damaged.")] = False,
) -> Output:
    """Show the topics, types, counts, times, rates and gaps of local recordings. Needs no server.

    The exit code is 0 even for a broken file, 8 if a file or folder cannot be read, and 2 if a path does not exist.
    """
    try:
        with watching(deep) as watch:
            inspections = inspect_paths(paths, depth=Depth.scan if deep else Depth.summary, progress=watch)
    except FileNotFoundError as error:
        raise InvalidInput(what=f"The path {error.filename}", reason="there is no such file or folder") from error
    if not inspections:
        note("There are no recordings in it.")
    unreadable = [one for one in inspections if one.summary.content is Content.error]
    for one in unreadable:
        note(one.summary.reason or one.path)

    def show_all() -> None:
        for number, one in enumerate(inspections):
            if number:
                line("")
            show(one)

    items = [to_plain(one) for one in inspections]
    return Output({"items": items}, show_all, ExitCode.local_file if unreadable else 0)


def show(one: Inspection) -> None:
    """Print the properties, topics and problems of one file or recording."""
    summary = one.summary
    compression = ", ".join(name for name in summary.compression if name != "none")
    is_checked = summary.depth is Depth.scan and summary.content is Content.indexed
    facts: dict[str, list[str]] = {}
    for fact in summary.facts:
        facts.setdefault(fact.name.replace("_", " "), []).append(f"{fact.value} {fact.unit}".strip())
    topics = len(summary.topics)
    in_topics = f"in {topics} {'topic' if topics == 1 else 'topics'}"
    details(
        [
            (one.kind.value, one.path),
            ("files", [Path(member).name for member in one.members] if len(one.members) > 1 else None),
            ("format", summary.format.value + (f" ({compression})" if compression else "")),
            (
                "content",
                f"{summary.content.value} ({_CONTENTS[summary.content]}{', every byte checked' if is_checked else ''})",
            ),
            ("reason", summary.reason),
            ("lost", _lost(summary)),
            ("messages", None if summary.message_count is None else f"{summary.message_count} {in_topics}"),
            ("start", instant(summary.start_ns)),
            ("span", span(summary.start_ns, summary.end_ns)),
            ("written by", ", ".join(text for text in (summary.library, summary.profile) if text)),
            *facts.items(),
        ]
    )
    if summary.topics:
        line("")
        is_disordered = any(topic.out_of_order_count for topic in summary.topics)
        cells = []
        for topic in summary.topics:
            gaps = (duration(gap_ns) for gap_ns in (topic.longest_gap_ns, topic.head_gap_ns, topic.tail_gap_ns))
            disorder = [topic.out_of_order_count] if is_disordered else []
            cells.append([topic.name, topic.message_type or None, topic.count, rate(topic.rate_hz), *gaps, *disorder])
        headers = ["topic", "type", "count", "rate", "longest gap", "head gap", "tail gap"]
        table([*headers, "out of order"] if is_disordered else headers, cells)
    if summary.problems:
        line("")
        line("Warnings:")
        for problem in summary.problems:
            line(f"  {problem.where}: {problem.message}")


def _lost(summary: RecordingSummary) -> str | None:
    lost = summary.lost
    if lost is None:
        return None
    if lost == Lost(0, 0, 0):
        return "nothing"
    # A database consists of pages, not chunks.
    piece = "page" if summary.format is RecordingFormat.rosbag2_db3 else "chunk"
    parts = [count(lost.messages, "message") if lost.messages is not None else "an unknown number of messages"]
    if lost.chunks:
        parts.append(f"{lost.chunks} {piece}{'' if lost.chunks == 1 else 's'}")
    if lost.bytes:
        parts.append(f"{size(lost.bytes)}")
    return ", ".join(parts)


def sample(
    directory: Annotated[Path, argument("DIR", "Folder to create the files in.")],
    size_: Annotated[str, option("--size", "SIZE", "Set the size of all files of the vehicle together.")] = "50MB",
    duration_s: Annotated[
        float | None, option("--duration", "SECONDS", "Set how long the robot drives or walks.", min=0.1)
    ] = None,
    seed: Annotated[int, option("--seed", None, "Set the seed. The same seed gives the same bytes.")] = 1,
    formats: Annotated[Many, option("--format", None, "Create mcap, bag or db3 files; repeatable.")] = None,
    rig: Annotated[
        Rig, option("--rig", None, "Choose a small vehicle, or a legged robot with four computers.")
    ] = Rig.vehicle,
    defects: Annotated[Many, option("--defect", "NAME", "Add this defect; repeatable.")] = None,
    drop_topic: Annotated[Text, option("--drop-topic", None, "Omit this topic.")] = None,
    truncate: Annotated[
        float | None, option("--truncate", None, "Truncate each file to this fraction of it.", min=0.01, max=0.99)
    ] = None,
) -> Output:
    """Create a sample mission of a small vehicle or a legged robot, with the defects that you choose.

    The vehicle has a camera, a lidar, an IMU, GPS, odometry and transforms. The legged robot has twelve cameras, two
    lidars, five IMUs, GNSS, joints and a battery; each of its four computers records one file (--format, mcap by
    default).

    Defects: gap wrong-rate dropped-topic wrong-type repeated-static silent-start silent-end clock-jump stamp-offset
    stamp-drift stamp-jump black-camera overexposed-camera frozen-camera blurred-camera tilted-gravity wrong-gravity
    saturated-imu constant-imu no-fix position-jump empty-clouds far-points disconnected-tf odometry-jump nan truncated.
    Of the legged robot only: stuck-value value-range low-battery missing-computer late-computer early-end
    empty-recording recorder-offset missing-file.
    """
    from kleinkram.recordings.sample import Defect, Faults, SampleFormat, generate_mission, generate_rig

    size_bytes = parse_size(size_)
    with _sample_errors(directory):
        kinds = [SampleFormat(name) for name in formats or ()]
        made = frozenset(Defect(name) for name in defects or ())
        faults = Faults(dropped_topic=drop_topic, truncate_to=truncate, defects=made)
        if rig is Rig.vehicle:
            truth = generate_mission(
                directory,
                size_bytes=None if duration_s else size_bytes,
                duration_s=duration_s,
                seed=seed,
                formats=kinds or [*SampleFormat],
                faults=faults,
            )
        elif len(kinds) > 1:
            raise ValueError("a legged robot records in one format")
        else:
            kind = kinds[0] if kinds else SampleFormat.mcap
            truth = generate_rig(directory, duration_s=duration_s or 10, seed=seed, kind=kind, faults=faults)
    items = [
        {**vars(file), "path": str(file.path), "topics": [vars(topic) for topic in file.topics]} for file in truth.files
    ]
    return Output({"items": items}, lambda: _show_sample(truth))


@contextlib.contextmanager
def _sample_errors(directory: Path) -> Iterator[None]:
    """Explain why a sample cannot be created in a folder."""
    what = f"The folder {str(directory)!r}"
    try:
        yield
    except FileExistsError as error:
        raise InvalidInput(what=what, reason=str(error)) from None
    except ValueError as error:
        raise InvalidInput(what="The sample", reason=str(error)) from None
    except OSError as error:
        raise InvalidInput(what=what, reason=error.strerror or str(error)) from None
    except KeyboardInterrupt:
        raise Interrupted from None


def _show_sample(truth: "MissionTruth") -> None:
    rows = []
    for file in truth.files:
        content = (file.message_count, len(file.topics), span(file.start_ns, file.end_ns))
        rows.append((str(file.path), size(file.size_bytes), *content))
    table(["file", "size", "messages", "topics", "span"], rows)
