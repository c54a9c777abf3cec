"""Files that are compressed as a whole (`.mcap.zstd`, `.db3.zstd`, `.bag.zst`): decompressed, then read like others.

What is inside goes through a temporary file, because every format is better read with its size known and more than
once. The window and the output are bounded; where the compressed data breaks off, what came out until there is read.

Source: RFC 8878; rosbag2_compression (compression mode FILE).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import PurePosixPath

import zstandard

from kleinkram.recordings.compression import ZstdFrames, open_decompressed
from kleinkram.recordings.errors import Malformed, NotARecording
from kleinkram.recordings.formats.base import LONG_HEAD_BYTES, Format, Member, OpenContext, RecordingFile, check_cost
from kleinkram.recordings.limits import FREE_UNPACKED, MAX_EXPANSION, MAX_ZSTD_WINDOW, WINDOW
from kleinkram.recordings.model import Content, Depth, Lost, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import FileSource, SequentialReader, Source, SourceReader, source_reader
from kleinkram.recordings.temporary_files import MAX_SPOOL_BYTES, TooLarge, temporary_copy
from kleinkram.recordings.topic_statistics import pending

FILE_ZSTD = "file-zstd"
"""What `compression` says of a file that is compressed as a whole."""

Scan = Callable[[SequentialReader], RecordingSummary]


class _ZstdReader:
    """Decompresses a zstd file, up to its end or to where it is damaged.

    Attributes:
        fault: once nothing more comes out, why it is not all, in words.
        packed_bytes: bytes of the file read so far.
    """

    def __init__(self, reader: SequentialReader) -> None:
        self.fault: str | None = None
        self.packed_bytes = 0
        self._reader = reader
        self._frames = ZstdFrames()
        self._pieces = self._unpack()
        self._left = b""

    def read(self, length: int) -> bytes:
        """Return the next bytes, at most `length`; b"" at the end."""
        if not self._left:
            self._left = next(self._pieces, b"")
        piece, self._left = self._left[:length], self._left[length:]
        return piece

    def peek(self, length: int) -> bytes:
        """Return the next bytes without passing them."""
        while len(self._left) < length and (piece := next(self._pieces, b"")):
            self._left += piece
        return self._left[:length]

    def _unpack(self) -> Iterator[bytes]:
        """Yield pieces of bounded size: what unpacks to a thousand times its size does so in small steps."""
        decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_ZSTD_WINDOW)
        reader = decompressor.stream_reader(_Packed(self._next_packed), read_across_frames=True)  # type: ignore[arg-type]  # only read() is used
        try:
            while piece := reader.read(WINDOW):
                yield piece
        except zstandard.ZstdError as error:
            # zstandard has one error for bad data and for too little memory. The latter is not the file's fault:
            # whether there was enough is tried out, and a MemoryError says that there was not.
            bytearray(MAX_ZSTD_WINDOW)
            self.fault = f"its zstd data is damaged within the first {self.packed_bytes} bytes ({error})"
            return
        if not self._frames.at_end_of_frame:
            self.fault = f"its zstd data breaks off at byte {self.packed_bytes}"

    def _next_packed(self, length: int) -> bytes:
        data = self._reader.read(length)
        self.packed_bytes += len(data)
        self._frames.feed(data)
        return data


class _Packed:
    """File-like input of zstandard's reader."""

    def __init__(self, read: Callable[[int], bytes]) -> None:
        self.read = read


def scan_zstd_file(reader: SequentialReader, scan: Scan, *, most_bytes: int = MAX_SPOOL_BYTES) -> RecordingSummary:
    """Read a compressed file; `scan` reads what is inside, under its name without `.zstd`.

    `format` is that of what is inside, `compression` says "file-zstd". A file whose compressed data is damaged is
    `recovered` as far as it unpacks; one that unpacks to more than `most_bytes`, or
    than any recording does, is `pending`.

    Raises:
        SourceError: as `SequentialReader.read`, or the unpacked copy cannot be written.
    """
    from kleinkram.recordings.formats import registry  # which imports this module

    unpacking = _ZstdReader(reader)
    most_bytes = min(most_bytes, FREE_UNPACKED + MAX_EXPANSION * reader.size_bytes)
    inner_format = registry.format_of_head(unpacking.peek(LONG_HEAD_BYTES))
    kind = inner_format.kind
    if not is_recording(inner_format):
        return _not_a_recording(kind, unpacking)
    try:
        with temporary_copy(unpacking.read, most_bytes=most_bytes) as path, FileSource(path) as source:
            inner = SourceReader(source, path=path)
            inner.name = PurePosixPath(reader.name).stem
            summary = scan(inner)
    except TooLarge as error:
        return RecordingSummary(kind, Content.pending, str(error), compression=(FILE_ZSTD,))
    compression = tuple(sorted({FILE_ZSTD, *summary.compression} - {"none"}))
    summary = replace(summary, compression=compression, bytes_read=reader.size_bytes, depth=Depth.scan)
    return _with_fault(summary, unpacking) if unpacking.fault else summary


def _not_a_recording(kind: RecordingFormat, unpacking: _ZstdReader) -> RecordingSummary:
    if unpacking.fault and kind in (RecordingFormat.unknown, RecordingFormat.empty):
        return RecordingSummary(RecordingFormat.zstd, Content.broken, unpacking.fault, depth=Depth.scan)
    reason = f"compressed as a whole; inside is {kind.value}"
    return RecordingSummary(RecordingFormat.zstd, Content.opaque, reason, depth=Depth.scan)


def _with_fault(summary: RecordingSummary, unpacking: _ZstdReader) -> RecordingSummary:
    inside = f"; inside: {summary.reason}" if summary.reason else ""
    content = Content.recovered if summary.content is Content.indexed else summary.content
    return replace(summary, content=content, reason=f"{unpacking.fault}{inside}", lost=summary.lost or Lost(0, 0, None))


def is_recording(file_format: Format) -> bool:
    """Return whether files of a format hold messages."""
    return file_format.open is not None or file_format.kind is RecordingFormat.svo2


def _scan(reader: SequentialReader) -> RecordingSummary:
    from kleinkram.recordings.summary import scan  # which imports this module

    return scan_zstd_file(reader, scan)


def _summarise(source: Source, *, most_bytes: int) -> RecordingSummary:
    if source.size_bytes <= most_bytes:
        return _scan(source_reader(source))
    inside = _format_inside(source)
    if inside is not None and is_recording(inside):
        return pending(RecordingFormat.zstd, source.size_bytes, "it is compressed as a whole")
    kind = RecordingFormat.unknown if inside is None else inside.kind
    return RecordingSummary(RecordingFormat.zstd, Content.opaque, f"compressed as a whole; inside is {kind.value}")


def _format_inside(source: Source) -> Format | None:
    """Return the format of what is inside; None if its beginning cannot be decompressed."""
    from kleinkram.recordings.formats import registry  # which imports this module

    compressed = source.read(0, min(LONG_HEAD_BYTES, source.size_bytes))
    decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_ZSTD_WINDOW)
    try:
        with decompressor.stream_reader(compressed) as reader:
            return registry.format_of_head(reader.read(LONG_HEAD_BYTES))
    except zstandard.ZstdError:
        return None


def _open(file: RecordingFile, context: OpenContext) -> Member:
    """Decompress a file to a temporary one, as far as possible, and open that."""
    from kleinkram.recordings.formats import registry  # which imports this module

    source = file.source
    check_cost(source, context.limit_of(source), "it is compressed as a whole")
    content = open_decompressed("zstd", SourceReader(source).read, MAX_SPOOL_BYTES)

    def read(most: int) -> bytes:
        try:
            return content.take_some(most)
        except Malformed as error:
            context.problem_log.add("damaged", source.name, f"reading ends here: {error.message}")
            return b""

    path = context.copy(read, source.name)
    unpacked = context.stack.enter_context(FileSource(path))
    unpacked.name = PurePosixPath(source.name).stem
    inside = registry.format_of(unpacked)
    if inside is ZSTD:
        raise NotARecording(source.name, "it is compressed more than once")
    if inside.open is None:
        raise NotARecording(unpacked.name, inside.refusal)
    file.unpacked = RecordingFile(unpacked, path)
    return inside.open(file.unpacked, context)


ZSTD = Format(
    RecordingFormat.zstd,
    lambda head: head.data.startswith(b"\x28\xb5\x2f\xfd"),
    "compressed as a whole (zstd)",
    extensions=(".zstd", ".zst"),
    scan=_scan,
    summarise=_summarise,
    open=_open,
)
