"""`klein file preview`: what the preview of a recording shows, as a table or as files."""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import option
from kleinkram.cli.render import Output, note, table
from kleinkram.cli.units import count as count_of
from kleinkram.cli.units import instant
from kleinkram.client import Client
from kleinkram.client.errors import DestinationRefused, PreviewMissing

if TYPE_CHECKING:
    from kleinkram.recordings.previews import RecordingPreview, TopicSeries


def preview(
    client: Client,
    file: options.FileArgument,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    output: Annotated[
        Path | None, option("--output -o", "DIR", "Write thumbnails, series and tracks to this new folder.")
    ] = None,
) -> Output:
    """Show a recording by its preview, without reading the recording.

    The table has each topic with what is known of it: fields, thumbnails, positions, lines, points. With --output,
    thumbnails are written as JPEG, and series and tracks as CSV.
    """
    chosen = client.files.get(file, mission=mission, project=project)
    try:
        contents = client.files.preview(chosen.id)
    except PreviewMissing as error:
        raise PreviewMissing(path=chosen.path, reason=error.reason) from None
    rows = sorted(_rows(contents))
    document: dict[str, object] = {
        "start_ns": contents.start_ns,
        "end_ns": contents.end_ns,
        "read_share": contents.read_share,
        "topics": [dict(zip(("topic", "shown", "messages"), row, strict=True)) for row in rows],
        "log_lines": [{**vars(line), "severity": line.severity.value} for line in contents.log_lines],
        "left_out": [vars(left_out) for left_out in contents.left_out],
    }
    if output is not None:
        document["files"] = _write(contents, output)

    def show() -> None:
        table(["topic", "shown", "messages"], rows)
        for line in contents.log_lines[:10]:
            note(f"{instant(line.time_ns)} {line.severity.value} {line.topic} {line.source}: {line.text}")
        for left_out in contents.left_out[:10]:
            note(f"{left_out.topic} is left out: {left_out.reason}")

    return Output(document, show)


def _rows(contents: "RecordingPreview") -> Iterator[tuple[str, str, int | None]]:
    for series in contents.series:
        sampled = ", sampled" if series.is_sampled else ""
        yield series.topic, f"{count_of(len(series.fields), 'field')}{sampled}", series.message_count
    for strip in contents.cameras:
        yield strip.topic, count_of(len(strip.thumbnails), "thumbnail"), strip.message_count
    for track in contents.tracks:
        yield track.topic, f"{track.kind.value} track of {count_of(len(track.times_ns), 'position')}", None
    for topic in {cloud.topic for cloud in contents.clouds}:
        yield topic, count_of(sum(cloud.topic == topic for cloud in contents.clouds), "cloud"), None
    for topic in {line.topic for line in contents.log_lines}:
        yield topic, count_of(sum(line.topic == topic for line in contents.log_lines), "line"), None


def _write(contents: "RecordingPreview", folder: Path) -> list[str]:
    """Write the files of a preview; return their names."""
    written: list[str] = []
    try:
        folder.mkdir(parents=True)
        for number, series in enumerate(contents.series, 1):
            written.append(f"series-{number}{_name_part(series.topic)}.csv")
            _write_csv(folder / written[-1], _series_rows(series))
        for number, track in enumerate(contents.tracks, 1):
            written.append(f"track-{number}{_name_part(track.topic)}.csv")
            names = ("latitude", "longitude", "altitude") if track.kind.value == "gnss" else ("x", "y", "z")
            positions = zip(track.times_ns.tolist(), track.positions.tolist(), strict=True)
            _write_csv(folder / written[-1], [("time_ns", *names), *((at, *position) for at, position in positions)])
        for number, strip in enumerate(contents.cameras, 1):
            for picture in strip.thumbnails:
                written.append(f"camera-{number}{_name_part(strip.topic)}-{picture.time_ns}.jpg")
                (folder / written[-1]).write_bytes(picture.jpeg)
    except FileExistsError:
        raise DestinationRefused(path=str(folder), reason="it exists; remove it, or choose another name") from None
    except OSError as error:
        raise DestinationRefused(path=str(folder), reason=error.strerror or str(error)) from None
    return written


def _name_part(topic: str) -> str:
    """Return a topic as a part of a file's name: topics are untrusted."""
    letters = "".join(letter if letter.isascii() and letter.isalnum() else "." for letter in topic).strip(".")
    return f"-{letters[:80]}" if letters else ""


def _series_rows(series: "TopicSeries") -> Iterator[tuple[object, ...]]:
    yield ("first_ns", "last_ns", *(f"{field.name} {end}" for field in series.fields for end in ("min", "max")))
    columns = [series.first_ns, series.last_ns]
    for field in series.fields:
        columns += [field.low, field.high]  # type: ignore[list-item]  # times are integers
    yield from zip(*(column.tolist() for column in columns), strict=True)


def _write_csv(path: Path, rows: "Iterator[tuple[object, ...]] | list[tuple[object, ...]]") -> None:
    with path.open("x", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
