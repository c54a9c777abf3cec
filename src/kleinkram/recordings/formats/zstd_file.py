"""Compressed recordings (`.mcap.zstd`, `.db3.zstd`, `.bag.zst`): decompressed to a temporary file, then read.

What is inside goes through a temporary file, because every format is better read with its size known and more than
once. The window and the output are bounded; where the compressed data breaks off, what came out until there is read.

Source: RFC 8878; rosbag2_compression (compression mode FILE).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import PurePosixPath

import zstandard

from kleinkram.recordings.compression import open_decompressed
from kleinkram.recordings.errors import Cut, Malformed, NotARecording
from kleinkram.recordings.file_summary import pending
from kleinkram.recordings.formats.base import LONG_HEAD_BYTES, Format, OpenContext, OpenedFile, RecordingFile
from kleinkram.recordings.limits import FREE_UNPACKED, MAX_EXPANSION, MAX_ZSTD_WINDOW
from kleinkram.recordings.model import Content, Depth, Lost, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import FileSource, SequentialReader, Source, SourceReader, peek_bytes
from kleinkram.recordings.temporary_files import MAX_SPOOL_BYTES, TooLarge, temporary_copy

FILE_ZSTD = "file-zstd"  # what `compression` says of a file that is compressed as a whole

_NO_LIMIT = 2**63  # temporary files have one


class _Unpacked:
    """The content of a zstd file, up to its end or to where it is damaged; `fault` then says why it is not all."""

    def __init__(self, reader: SequentialReader) -> None:
        self.fault: str | None = None
        self._reader = reader
        self._packed_bytes = 0
        self._stream = open_decompressed("zstd", self._read_packed, _NO_LIMIT)

    def read(self, length: int) -> bytes:
        if self.fault is None:
            try:
                return self._stream.take_some(length)
            except Cut as error:
                self.fault = f"{error.message} at byte {self._packed_bytes}"
            except Malformed as error:
                self.fault = f"{error.message}, in the first {self._packed_bytes} bytes"
        return b""

    def _read_packed(self, length: int) -> bytes:
        data = self._reader.read(length)
        self._packed_bytes += len(data)
        return data


def scan_zstd_file(reader: SequentialReader, *, max_bytes: int = MAX_SPOOL_BYTES) -> RecordingSummary:
    """Read a compressed file: decompress it, and scan the result under its name without `.zstd`.

    A file whose compressed data is damaged is `recovered` as far as it unpacks; one that unpacks to more than
    `max_bytes`, or than any recording does, is `pending`.
    """
    from kleinkram.recordings import summary as formats  # imports this module

    unpacked = _Unpacked(reader)
    max_bytes = min(max_bytes, FREE_UNPACKED + MAX_EXPANSION * reader.size_bytes)
    head, read = peek_bytes(unpacked.read, LONG_HEAD_BYTES)
    inside = formats.format_of_head(head)
    if not is_recording(inside):
        if unpacked.fault and inside.kind in (RecordingFormat.unknown, RecordingFormat.empty):
            return RecordingSummary(RecordingFormat.zstd, Content.broken, unpacked.fault, depth=Depth.scan)
        return replace(_not_a_recording(inside.kind), depth=Depth.scan)
    try:
        with temporary_copy(read, max_bytes=max_bytes) as path, FileSource(path) as source:
            inner = SourceReader(source)
            inner.name = PurePosixPath(reader.name).stem
            summary = formats.scan(inner)
    except TooLarge as error:
        return RecordingSummary(inside.kind, Content.pending, str(error), compression=(FILE_ZSTD,))
    compression = tuple(sorted({FILE_ZSTD, *summary.compression} - {"none"}))
    summary = replace(summary, compression=compression, bytes_read=reader.size_bytes, depth=Depth.scan)
    if not unpacked.fault:
        return summary
    reason = f"{unpacked.fault}; inside: {summary.reason}" if summary.reason else unpacked.fault
    content = Content.recovered if summary.content is Content.indexed else summary.content
    return replace(summary, content=content, reason=reason, lost=summary.lost or Lost(0, 0, None))


def _not_a_recording(kind: RecordingFormat) -> RecordingSummary:
    return RecordingSummary(RecordingFormat.zstd, Content.opaque, f"compressed as a whole; inside is {kind.value}")


def is_recording(file_format: Format) -> bool:
    """Return whether files of a format hold messages."""
    return file_format.open is not None or file_format.kind is RecordingFormat.svo2


def _summarise(source: Source, max_bytes: int) -> RecordingSummary:
    from kleinkram.recordings import summary as formats  # imports this module

    if source.size_bytes <= max_bytes:
        return scan_zstd_file(SourceReader(source))
    decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_ZSTD_WINDOW)
    try:
        with decompressor.stream_reader(source.read(0, min(LONG_HEAD_BYTES, source.size_bytes))) as reader:
            inside = formats.format_of_head(reader.read(LONG_HEAD_BYTES))
    except zstandard.ZstdError:  # its beginning cannot be decompressed
        return _not_a_recording(RecordingFormat.unknown)
    if is_recording(inside):
        return pending(RecordingFormat.zstd, source.size_bytes, "it is compressed as a whole")
    return _not_a_recording(inside.kind)


def _open(file: RecordingFile, context: OpenContext) -> OpenedFile:
    from kleinkram.recordings import summary as formats  # imports this module

    source = file.source
    context.check_cost(source, "it is compressed as a whole")
    unpacked = _Unpacked(SourceReader(source))
    path = context.copy(unpacked.read, source.name)
    if unpacked.fault:
        context.problem_log.add("damaged", source.name, f"reading ends here: {unpacked.fault}")
    inner = context.stack.enter_context(FileSource(path))
    inner.name = PurePosixPath(source.name).stem
    inside = formats.format_of(inner)
    if inside is ZSTD:
        raise NotARecording(source.name, "it is compressed more than once")
    if inside.open is None:
        raise NotARecording(inner.name, inside.refusal)
    file.unpacked = RecordingFile(inner, path)
    return inside.open(file.unpacked, context)


ZSTD = Format(
    RecordingFormat.zstd,
    lambda head: head.data.startswith(b"\x28\xb5\x2f\xfd"),
    "compressed as a whole (zstd)",
    extensions=(".zstd", ".zst"),
    scan=scan_zstd_file,
    summarise=_summarise,
    open=_open,
)
