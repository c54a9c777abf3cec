"""The file of a preview (docs/formats.md): an index, and sections behind it, which a client can fetch by ranges.

Bytes of a preview come from a process that parsed an untrusted recording, so `read_preview` believes none of them.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding.types import ReadingExtraMissing
from kleinkram.recordings.errors import RecordingError
from kleinkram.recordings.geo_position import GeoPosition, usable_position
from kleinkram.recordings.previews.model import (
    CameraStrip,
    FieldSeries,
    LeftOutTopic,
    LogLine,
    LogSeverity,
    PositionTrack,
    RecordingPreview,
    ThinnedCloud,
    Thumbnail,
    TopicSeries,
    TrackKind,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAGIC = b"KLPREV1\n"
PREVIEW_VERSION = 1
"""Of what previews contain; a server makes those of an earlier version again."""

# Types whose positions are degrees, and where the receiver was.
_FIX = re.compile(r"(NavSatFix|GPSFix|LocationFix)$")
_HEAD = struct.Struct("<8sII")  # magic, stored and unpacked bytes of the index
_LEVEL = 1  # numbers of sensors hardly shrink further
_MAX_INDEX_BYTES = 16 * 2**20
_MAX_UNPACKED_BYTES = 128 * 2**20  # of all sections together


class PreviewUnreadable(RecordingError):
    """The bytes are not a preview of a version that this program reads, or are damaged."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"The preview cannot be read: {reason}.")


# -- writing ----------------------------------------------------------------------------------------------------------


class _Sections:
    """Collects the sections, and returns what the index says of each."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self._size_bytes = 0

    def array(self, values: NDArray[Any]) -> dict[str, object]:
        """Add numbers, little-endian and compressed."""
        raw = values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()
        return {**self._add(zlib.compress(raw, _LEVEL)), "dtype": values.dtype.name, "unpacked": len(raw)}

    def text(self, value: object) -> dict[str, object]:
        """Add JSON, compressed."""
        raw = json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()
        return {**self._add(zlib.compress(raw, _LEVEL)), "unpacked": len(raw)}

    def files(self, files: Iterable[bytes]) -> dict[str, object]:
        """Add files as they are, one behind the other."""
        return self._add(b"".join(files))

    def _add(self, data: bytes) -> dict[str, object]:
        start = self._size_bytes
        self.parts.append(data)
        self._size_bytes += len(data)
        return {"offset": start, "length": len(data)}


def encode(preview: RecordingPreview) -> bytes:
    """Return the file of a preview."""
    sections = _Sections()
    index = {
        "version": PREVIEW_VERSION,
        "start_ns": _ns(preview.start_ns),
        "end_ns": _ns(preview.end_ns),
        "read_share": round(preview.read_share, 4),
        "cameras": [_camera(sections, strip) for strip in preview.cameras],
        "tracks": [_track(sections, track) for track in preview.tracks],
        "logs": {
            "count": preview.log_line_count,
            "lines": sections.text([_line(line) for line in preview.log_lines]),
        },
        "clouds": [_cloud(sections, cloud) for cloud in preview.clouds],
        "series": [_series(sections, series) for series in preview.series],
        "left_out": [{"topic": left_out.topic, "reason": left_out.reason} for left_out in preview.left_out],
        **({"read_spans": sections.array(preview.read_spans)} if len(preview.read_spans) else {}),
    }
    text = json.dumps(index, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "replace")
    stored = zlib.compress(text, _LEVEL)
    return b"".join((_HEAD.pack(MAGIC, len(stored), len(text)), stored, *sections.parts))


def _ns(time_ns: int | None) -> str | None:
    """Return a time as text: JavaScript's numbers have 53 bits."""
    return None if time_ns is None else str(time_ns)


def _series(sections: _Sections, series: TopicSeries) -> dict[str, object]:
    return {
        "topic": series.topic,
        "type": series.message_type,
        "count": series.message_count,
        "messages_per_bin": series.messages_per_bin,
        "is_sampled": series.is_sampled,
        "first_ns": sections.array(series.first_ns),
        **({} if series.messages_per_bin == 1 else {"last_ns": sections.array(series.last_ns)}),
        "fields": [_field(sections, field) for field in series.fields],
    }


def _field(sections: _Sections, field: FieldSeries) -> dict[str, object]:
    """Return a field's entry: one number, if it has no other; without `high`, if it is equal to `low`."""
    import numpy as np

    low, high = _shortest(field.low), _shortest(field.high)
    if len(low) and np.isfinite(low[0]) and bool((low == low[0]).all()) and bool((high == low[0]).all()):
        return {"name": field.name, "constant": float(low[0])}
    entry: dict[str, object] = {"name": field.name, "low": sections.array(low)}
    if not np.array_equal(field.low, field.high, equal_nan=True):
        entry["high"] = sections.array(high)
    return entry


def _shortest(values: NDArray[Any]) -> NDArray[Any]:
    """Return numbers as float32 if it has all of them exactly."""
    import numpy as np

    with np.errstate(over="ignore"):
        short = values.astype(np.float32)
    return short if np.array_equal(short.astype(np.float64), values, equal_nan=True) else values


def _camera(sections: _Sections, strip: CameraStrip) -> dict[str, object]:
    return {
        "topic": strip.topic,
        "count": strip.message_count,
        "files": sections.files(picture.jpeg for picture in strip.thumbnails),
        "thumbnails": [
            {"time_ns": _ns(picture.time_ns), "width": picture.width, "height": picture.height, "size": size}
            for picture, size in ((picture, len(picture.jpeg)) for picture in strip.thumbnails)
        ],
    }


def _track(sections: _Sections, track: PositionTrack) -> dict[str, object]:
    return {
        "topic": track.topic,
        "kind": track.kind.value,
        "count": track.message_count,
        "times_ns": sections.array(track.times_ns),
        "positions": sections.array(track.positions),
    }


def _line(line: LogLine) -> list[object]:
    return [_ns(line.time_ns), line.topic, line.severity.value, line.source, line.text]


def _cloud(sections: _Sections, cloud: ThinnedCloud) -> dict[str, object]:
    return {
        "topic": cloud.topic,
        "time_ns": _ns(cloud.time_ns),
        "frame_id": cloud.frame_id,
        "count": cloud.point_count,
        "xyz": sections.array(cloud.xyz),
    }


# -- reading ----------------------------------------------------------------------------------------------------------


def read_preview(data: bytes) -> RecordingPreview:
    """Parse the file of a preview.

    Raises:
        PreviewUnreadable: it is no such file, of another version, or damaged.
        ReadingExtraMissing: numpy is not installed.
    """
    try:
        import numpy  # noqa: F401  # only to name it where it is missing
    except ImportError:
        raise ReadingExtraMissing("numpy") from None
    with _named_damage():
        return _Parser(data).preview()


def representative_thumbnail(data: bytes) -> Thumbnail | None:
    """Return the thumbnail in the middle of the camera with the most pictures; None without any. Needs no numpy.

    Raises:
        PreviewUnreadable: it is no such file, of another version, or damaged.
    """
    with _named_damage():
        strips = [strip for strip in _Parser(data).cameras() if strip.thumbnails]
    if not strips:
        return None
    thumbnails = max(strips, key=lambda strip: strip.message_count).thumbnails
    return thumbnails[len(thumbnails) // 2]


def first_position(data: bytes) -> GeoPosition | None:
    """Return the earliest usable position of the topics of known types; None without any.

    Raises:
        PreviewUnreadable: it is no such file, of another version, or damaged.
    """
    with _named_damage():
        parser = _Parser(data)
        # Other messages with a latitude may be in radians, or goals.
        fixes = {topic for topic, message_type in parser.types().items() if _FIX.search(message_type)}
        tracks = [track for track in parser.tracks() if track.kind is TrackKind.gnss and track.topic in fixes]
    earliest: tuple[int, GeoPosition] | None = None
    for track in tracks:
        for time_ns, (latitude, longitude, _) in zip(track.times_ns, track.positions, strict=True):
            position = usable_position(latitude, longitude)
            if position is not None:
                if earliest is None or time_ns < earliest[0]:
                    earliest = int(time_ns), position
                break
    return earliest and earliest[1]


@contextmanager
def _named_damage() -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise PreviewUnreadable(f"its index is damaged ({type(error).__name__})") from error


class _Parser:
    def __init__(self, data: bytes) -> None:
        if len(data) < _HEAD.size:
            raise PreviewUnreadable("it is too short")
        magic, stored, unpacked = _HEAD.unpack_from(data)
        if magic != MAGIC:
            raise PreviewUnreadable("it does not begin like one")
        if unpacked > _MAX_INDEX_BYTES:
            raise PreviewUnreadable("its index is too large")
        self._unpacked_left = _MAX_UNPACKED_BYTES
        self._sections = memoryview(data)[_HEAD.size + stored :]
        self._index: Mapping[str, Any] = json.loads(
            _unpacked(memoryview(data)[_HEAD.size : _HEAD.size + stored], unpacked)
        )
        if self._index["version"] != PREVIEW_VERSION:
            raise PreviewUnreadable(f"it has version {str(self._index['version'])[:20]}; {PREVIEW_VERSION} is read")

    def preview(self) -> RecordingPreview:
        """Return what the index lists."""
        index, logs = self._index, self._index["logs"]
        return RecordingPreview(
            start_ns=_time(index["start_ns"]),
            end_ns=_time(index["end_ns"]),
            read_share=float(index["read_share"]),
            series=tuple(self._series(entry) for entry in index["series"]),
            cameras=self.cameras(),
            tracks=self.tracks(),
            log_lines=tuple(_read_line(entry) for entry in json.loads(self._unpack(logs["lines"]))),
            log_line_count=int(logs["count"]),
            clouds=tuple(self._cloud(entry) for entry in index["clouds"]),
            left_out=tuple(LeftOutTopic(str(entry["topic"]), str(entry["reason"])) for entry in index["left_out"]),
            read_spans=self._read_spans(),
        )

    def cameras(self) -> tuple[CameraStrip, ...]:
        """Return the thumbnails of all cameras."""
        return tuple(self._camera(entry) for entry in self._index["cameras"])

    def types(self) -> dict[str, str]:
        """Return the message types of the topics with numeric fields."""
        return {str(entry["topic"]): str(entry["type"]) for entry in self._index["series"]}

    def tracks(self) -> tuple[PositionTrack, ...]:
        """Return the positions of all topics."""
        return tuple(self._track(entry) for entry in self._index["tracks"])

    def _read_spans(self) -> NDArray[Any]:
        import numpy as np

        entry = self._index.get("read_spans")
        return np.empty((0, 2), np.int64) if entry is None else self._array(entry, "int64").reshape(-1, 2)

    def _bytes(self, entry: Mapping[str, Any]) -> memoryview:
        start, length = int(entry["offset"]), int(entry["length"])
        if start < 0 or length < 0 or start + length > len(self._sections):
            raise PreviewUnreadable("a section is outside the file")
        return self._sections[start : start + length]

    def _take(self, size_bytes: int) -> None:
        """Count bytes that are about to be allocated: entries may name the same section again and again."""
        self._unpacked_left -= size_bytes
        if size_bytes < 0 or self._unpacked_left < 0:
            raise PreviewUnreadable("its sections are too large")

    def _unpack(self, entry: Mapping[str, Any]) -> bytes:
        unpacked = int(entry["unpacked"])
        self._take(unpacked)
        return _unpacked(self._bytes(entry), unpacked)

    def _array(self, entry: Mapping[str, Any], *names: str) -> NDArray[Any]:
        import numpy as np

        if entry["dtype"] not in names:
            raise PreviewUnreadable("a section has numbers of another type")
        values = np.frombuffer(self._unpack(entry), np.dtype(entry["dtype"]).newbyteorder("<"))
        return values.astype(np.dtype(names[0]))

    def _series(self, entry: Mapping[str, Any]) -> TopicSeries:
        first_ns = self._array(entry["first_ns"], "int64")
        last_ns = self._array(entry["last_ns"], "int64") if "last_ns" in entry else first_ns
        return TopicSeries(
            topic=str(entry["topic"]),
            message_type=str(entry["type"]),
            message_count=int(entry["count"]),
            messages_per_bin=int(entry["messages_per_bin"]),
            first_ns=first_ns,
            last_ns=_of_length(last_ns, len(first_ns)),
            fields=tuple(self._field(field, len(first_ns)) for field in entry["fields"]),
            is_sampled=bool(entry["is_sampled"]),
        )

    def _field(self, entry: Mapping[str, Any], bins: int) -> FieldSeries:
        import numpy as np

        if "constant" in entry:
            self._take(bins * 8)
            values = np.full(bins, float(entry["constant"]))
            return FieldSeries(str(entry["name"]), values, values)
        low = _of_length(self._array(entry["low"], "float64", "float32"), bins)
        high = _of_length(self._array(entry["high"], "float64", "float32"), bins) if "high" in entry else low
        return FieldSeries(str(entry["name"]), low, high)

    def _camera(self, entry: Mapping[str, Any]) -> CameraStrip:
        files, at, thumbnails = self._bytes(entry["files"]), 0, []
        for one in entry["thumbnails"]:
            size = int(one["size"])
            self._take(size)
            if at + size > len(files):
                raise PreviewUnreadable("a thumbnail is outside its section")
            jpeg = bytes(files[at : at + size])
            thumbnails.append(Thumbnail(int(one["time_ns"]), int(one["width"]), int(one["height"]), jpeg))
            at += size
        return CameraStrip(str(entry["topic"]), int(entry["count"]), tuple(thumbnails))

    def _track(self, entry: Mapping[str, Any]) -> PositionTrack:
        times_ns = self._array(entry["times_ns"], "int64")
        positions = self._array(entry["positions"], "float64").reshape(len(times_ns), 3)
        return PositionTrack(str(entry["topic"]), TrackKind(entry["kind"]), int(entry["count"]), times_ns, positions)

    def _cloud(self, entry: Mapping[str, Any]) -> ThinnedCloud:
        xyz = self._array(entry["xyz"], "float32").reshape(-1, 3)
        topic, frame_id = str(entry["topic"]), str(entry["frame_id"])
        return ThinnedCloud(topic, int(entry["time_ns"]), frame_id, int(entry["count"]), xyz)


def _unpacked(data: memoryview, size_bytes: int) -> bytes:
    """Return what was compressed; it has exactly the announced size."""
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, size_bytes + 1)
    except zlib.error:
        raise PreviewUnreadable("a section is damaged") from None
    if len(unpacked) != size_bytes or not unpacker.eof:
        raise PreviewUnreadable("a section is damaged")
    return unpacked


def _time(text: object) -> int | None:
    return None if text is None else int(str(text))


def _of_length(values: NDArray[Any], length: int) -> NDArray[Any]:
    if len(values) != length:
        raise PreviewUnreadable("its sections have different lengths")
    return values


def _read_line(entry: list[str]) -> LogLine:
    time_ns, topic, severity, source, text = map(str, entry)
    return LogLine(int(time_ns), topic, LogSeverity(severity), source, text)
