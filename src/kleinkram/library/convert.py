# /// script
# requires-python = ">=3.10"
# dependencies = ["open-kleinkram[reading]"]
#
# [tool.kleinkram]
# name = "convert"
# description = "Recordings as MCAP or ROS 1 bag: converted, compressed anew, or repaired; or topics as Parquet."
# metrics = [
#   {name = "bytes_in", unit = "B", better = "lower"},
#   {name = "bytes_out", unit = "B", better = "lower"},
#   {name = "size_ratio", better = "lower", description = "bytes_out / bytes_in"},
#   {name = "messages", better = "higher", description = "written"},
#   {name = "lost_messages", better = "lower", description = "that a damaged recording is known to have had"},
# ]
# resources = {cores = 2, memory = "1GB", disk = "20GB", time = "12h"}
# right = "CREATE"
#
# [tool.kleinkram.inputs]
# paths = [
#   "*.mcap", "*.bag", "*.db3", "*.mcap.zst*", "*.db3.zst*", "*.bag.zst*", "*.bag.active", "*.ulg", "*metadata.yaml",
# ]
#
# [[tool.kleinkram.parameters]]
# name = "to"
# type = "choice"
# choices = ["mcap", "bag", "parquet"]
# default = "mcap"
# description = "One MCAP or ROS 1 bag a recording, or one Parquet file a topic."
#
# [[tool.kleinkram.parameters]]
# name = "ros1"
# type = "choice"
# choices = ["keep", "reencode"]
# default = "keep"
# description = "ROS 1 messages in an MCAP: kept as they are, or re-encoded as ROS 2 messages (CDR)."
#
# [[tool.kleinkram.parameters]]
# name = "recordings"
# type = "string"
# default = "*"
# description = "Names of recordings, such as nuc/*.bag; several are separated by spaces."
#
# [[tool.kleinkram.parameters]]
# name = "topics"
# type = "string"
# default = "*"
# description = "Topics, such as /camera/* /tf; several are separated by spaces."
#
# [[tool.kleinkram.parameters]]
# name = "compression"
# type = "choice"
# choices = ["zstd", "lz4", "bz2", "none"]
# default = "zstd"
# description = "Of the chunks of an MCAP (zstd, lz4, none), or of a bag (lz4, bz2, none; zstd means lz4)."
#
# [[tool.kleinkram.parameters]]
# name = "level"
# type = "integer"
# minimum = 0
# maximum = 22
# default = 0
# description = "Of the compression; higher is smaller and slower. 0: the usual one."
#
# [[tool.kleinkram.parameters]]
# name = "folder"
# type = "string"
# default = "derived"
# description = "Where the files are in the mission. Files that exist are not replaced."
#
# [[tool.kleinkram.parameters]]
# name = "to_mission"
# type = "boolean"
# default = true
# description = "Put the files into the mission; otherwise, they are artifacts of the run."
# ///
"""Converts the recordings of a mission.

A recording that already is what it would become is left out. Of a damaged one, what can be read becomes a whole file; a
finding says what was lost.
"""

import sys
import time
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from kleinkram.action import context, out, parameters, progress, report
from kleinkram.action.run_files import in_dir
from kleinkram.library.inputs import InputRecording, input_recordings
from kleinkram.recordings import (
    BagCompression,
    BagOptions,
    ChunkCompression,
    LeftOut,
    McapOptions,
    MemberLoss,
    RecordingError,
    Ros1Messages,
)
from kleinkram.recordings.model import counted
from kleinkram.recordings.writing.conversion import ConversionOptions, convert_recording, is_as_wanted, target_names

LOSSES_OF_TABLES = ("damaged", "damaged-message", "message-undecodable", "too-late", "topic-types-differ")
PROGRESS_EVERY_S = 1.0
SHOWN = 10


class CannotConvert(Exception):
    """The inputs or parameters give nothing to convert."""


def main() -> None:
    """Convert each recording; exit with 1 and a sentence if there is none, or if one could not be converted."""
    try:
        failed = run()
    except CannotConvert as error:
        report.finding("error", "convert.nothing", str(error)[:2000])
        sys.exit(str(error))
    if failed:
        sys.exit(f"not converted: {shown(failed)}")


def run() -> list[str]:
    """Convert the selected recordings; return the names of those that could not be converted."""
    options = conversion_options()
    recordings = with_topics(selected_recordings(words("recordings")))
    failed: list[str] = []
    targets = target_names([recording.name for recording in recordings])
    for number, (recording, target) in enumerate(zip(recordings, targets, strict=True)):
        show = progress_of(recording, number, len(recordings))
        try:
            if parameters()["to"] == "parquet":
                to_parquet(recording, target, show)
            else:
                to_file(recording, target, options, show)
        except (RecordingError, OSError) as error:
            report_finding("error", "convert.failed", str(error), recording)
            print(f"{recording.name}: {error}", flush=True)
            failed.append(recording.name)
    return failed


def progress_of(recording: InputRecording, number: int, count: int) -> Callable[[float], None]:
    """Return a function that shows the progress of one of several recordings, at most once a second."""
    shown_at = -PROGRESS_EVERY_S

    def show(share: float) -> None:
        nonlocal shown_at
        if time.monotonic() >= shown_at + PROGRESS_EVERY_S:
            shown_at = time.monotonic()
            progress((number + share) / count, recording.name[-200:])

    return show


def words(name: str) -> list[str]:
    """Return the words of a parameter, which spaces or commas separate."""
    return str(parameters()[name]).replace(",", " ").split() or ["*"]


def conversion_options() -> ConversionOptions:
    """Return how MCAPs and bags are written."""
    level, compression = int(parameters()["level"]) or None, str(parameters()["compression"])
    if parameters()["to"] == "bag":
        return BagOptions(BagCompression("lz4" if compression == "zstd" else compression))
    if compression == "bz2" and parameters()["to"] == "mcap":
        raise CannotConvert("compression: an MCAP has zstd, lz4 or none, and no bz2")
    try:
        kind = ChunkCompression("zstd" if compression == "bz2" else compression)
        return McapOptions(kind, level, ros1=Ros1Messages(str(parameters()["ros1"])))
    except ValueError as error:
        raise CannotConvert(f"level: {error}") from None


def selected_recordings(patterns: Sequence[str]) -> list[InputRecording]:
    """Return the inputs that patterns name and no run made."""
    recordings = [recording for recording in input_recordings() if not recording.is_derived]
    if not recordings:
        raise CannotConvert("the mission has no recording that can be read (MCAP, ROS 1 bag, rosbag2)")
    for pattern in patterns:
        if not any(fnmatchcase(recording.name, pattern) for recording in recordings):
            names = shown([recording.name for recording in recordings])
            raise CannotConvert(f"no recording is called {pattern}; there are {names}")
    return [one for one in recordings if any(fnmatchcase(one.name, pattern) for pattern in patterns)]


def with_topics(recordings: Sequence[InputRecording]) -> list[InputRecording]:
    """Return the recordings that have wanted topics; the others are left out."""
    if words("topics") == ["*"]:
        return [*recordings]
    having = [recording for recording in recordings if wanted_topics(recording)]
    if not having:
        topics = sorted({topic.name for recording in recordings for topic in recording.topics})
        raise CannotConvert(
            f"no recording has a topic {' '.join(words('topics'))}; there are {shown(topics) or 'none'}"
        )
    for recording in recordings:
        if recording not in having:
            leave_out(recording, "it has none of the topics")
    return having


def wanted_topics(recording: InputRecording) -> list[str]:
    """Return the names of the topics of a recording that are wanted."""
    names = [topic.name for topic in recording.topics]
    return [name for name in names if any(fnmatchcase(name, pattern) for pattern in words("topics"))]


def to_file(recording: InputRecording, target: str, options: ConversionOptions, show: Callable[[float], None]) -> None:
    """Write one recording as MCAP or bag, and report file, numbers and losses."""
    if any(topic.message_encoding == "ulog" for topic in recording.topics):
        leave_out(recording, "its messages are those of a ULog; its topics can be tables (to=parquet)")
        return
    path = out / f"{target}{'.bag' if isinstance(options, BagOptions) else '.mcap'}"
    topics = None if words("topics") == ["*"] else wanted_topics(recording)
    with recording.open() as reader:
        if topics is None and is_as_wanted(reader, options):
            leave_out(recording, f"it is a whole {path.suffix[1:]} ({options.compression.value}) already")
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        result = convert_recording(reader, path, options, topics, sha256=known_hashes(recording), on_progress=show)
    report_losses(recording, result.losses)
    report_left_out(recording, result.left_out)
    put(recording, path, path.relative_to(out).as_posix())
    report_sizes(recording, result.message_count, result.size_bytes)


def to_parquet(recording: InputRecording, target: str, show: Callable[[float], None]) -> None:
    """Write the topics of one recording as Parquet, and report files, numbers and what was left out."""
    with recording.open() as reader:
        result = reader.to_parquet(out / target, wanted_topics(recording), on_progress=show)
        losses = [problem for problem in reader.problems if problem.code in LOSSES_OF_TABLES]
    for problem in losses:
        report_finding("warning", "convert.loss", f"{problem.where}: {problem.message}", recording)
    for topic in result.left_out:
        report_finding("warning", "convert.topic", f"left out: {topic.reason}", recording, topic.topic)
    for file in result.files:
        put(recording, file.path, file.path.relative_to(out).as_posix())
    rows = sum(file.row_count for file in result.files)
    report_sizes(recording, rows, sum(file.size_bytes for file in result.files))


def known_hashes(recording: InputRecording) -> dict[str, str]:
    """Return the SHA-256 of the files of a recording, by their names without folder."""
    hashes = {file.path: file.sha256 for file in context().files}
    known = ((path.name, hashes.get(path.relative_to(in_dir).as_posix())) for path in recording.paths)
    return {name: sha256 for name, sha256 in known if sha256}


def put(recording: InputRecording, path: Path, target: str) -> None:
    """Put a file into the mission, if that is wanted."""
    if parameters()["to_mission"]:
        folder = str(parameters()["folder"]).strip("/ ")
        report.mission_file(path, f"{folder}/{target}" if folder else target, derived_from=[*recording.paths])
    print(f"{recording.name} -> {path.relative_to(out)}: {path.stat().st_size} bytes", flush=True)


def leave_out(recording: InputRecording, reason: str) -> None:
    """Say that a recording needs no conversion."""
    report_finding("info", "convert.unchanged", f"left out: {reason}", recording)
    print(f"{recording.name}: left out: {reason}", flush=True)


def report_sizes(recording: InputRecording, messages: int, bytes_out: int) -> None:
    """Report the numbers of one recording."""
    file, bytes_in = recording.paths[-1], sum(path.stat().st_size for path in recording.paths)
    report.metric("bytes_in", bytes_in, unit="B", file=file)
    report.metric("bytes_out", bytes_out, unit="B", file=file)
    if bytes_in:
        report.metric("size_ratio", bytes_out / bytes_in, file=file)
    report.metric("messages", messages, file=file)


def report_losses(recording: InputRecording, losses: Sequence[MemberLoss]) -> None:
    """Report what of a recording could not be read."""
    for loss in losses:
        report_finding("warning", "convert.loss", f"{loss.file}: {loss.reason}", recording)
        for place in loss.places:
            span = (
                f" (log times {place.after_ns} to {place.before_ns} ns)" if place.after_ns and place.before_ns else ""
            )
            report_finding("info", "convert.lost_place", f"{place.where}: {place.reason}{span}", recording)
    known = [loss.messages for loss in losses if loss.messages is not None]
    if len(known) == len(losses):
        report.metric("lost_messages", sum(known), file=recording.paths[-1])


def report_left_out(recording: InputRecording, left_out: Sequence[LeftOut]) -> None:
    """Report the messages that the output cannot hold."""
    for part in left_out:
        reason = f"{counted(part.message_count, 'message')} left out: {part.reason}"
        report_finding("warning", "convert.topic", reason, recording, part.topic)


def report_finding(severity: str, code: str, message: str, recording: InputRecording, topic: str | None = None) -> None:
    """Report a finding about a recording; the texts in it may come from a damaged file."""
    message, topic = message.replace("\0", "")[:2000], topic and topic.replace("\0", "")[:1024]
    report.finding(severity, code, message, file=recording.paths[-1], topic=topic or None)


def shown(names: Sequence[str]) -> str:
    """Return the first names as text."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


if __name__ == "__main__":
    main()
