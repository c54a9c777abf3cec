"""Writes the images of a topic as files: `TOPIC/STAMP.png`, and `TOPIC/index.csv`.

A JPEG or PNG in a message is written as it is, byte for byte. What is not compressed becomes a PNG of 8 or 16 bits
(lossless), and depth in float32 a TIFF. Files have colours in RGB order, whatever order the message has; a Bayer mosaic
stays a mosaic, and 16-bit depth keeps its values. The name of a file is the stamp of the header in nanoseconds, with 19
digits; the log time where a message has no stamp.

Memory: one message and its picture. A picture is decoded only once its size is known and at most `MAX_PIXELS`.
"""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, image, stamp_ns
from kleinkram.recordings.decoding.sensor_data import CAMERA_TYPES, VIDEO_TYPES, compressed_image
from kleinkram.recordings.decoding.tables import TimedMessage
from kleinkram.recordings.decoding.values import NS, part, type_name
from kleinkram.recordings.errors import CannotWrite
from kleinkram.recordings.messages import END_OF_TIME_NS, Selection
from kleinkram.recordings.writing.new_file import lock, refuse_existing, sync_folder
from kleinkram.recordings.writing.topic_rows import FrameNames, NamedRecording, OnRows, TopicGroup, Written, messages_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_PIXELS = 32_000_000
INDEX_NAME = "index.csv"

_HEADERS = ("stamp_ns", "log_time_ns", "file", "width", "height", "encoding", "frame_id", "recording")
_OPENCV_COLOUR = re.compile(r"(?:8|16)uc[34]")
_JPEG_QUALITY = 95
_PNG_LEVEL = 3  # of zlib; higher is slower, and a few percent smaller
_PNG_COLOURS = {1: 0, 2: 4, 3: 2, 4: 6}  # channels: colour type
_BROKEN = (DecodeError, OverflowError, ValueError, TypeError)  # the last three: JSON has fields of any type


@dataclass(frozen=True)
class ImageOptions:
    """Which images are written, and how.

    Attributes:
        every: the first of so many images of a topic.
        rate_hz: at most so many images a second of log time, the first of each part of it; None: all.
        as_jpeg: images of 8 bits that are not compressed become JPEG (lossy, quality 95) in place of PNG.
    """

    every: int = 1
    rate_hz: float | None = None
    as_jpeg: bool = False

    def __post_init__(self) -> None:
        """Check the numbers; ValueError for one that selects nothing, and for both."""
        if self.every != 1 and self.rate_hz is not None:
            raise ValueError("specify one of every and rate")
        if self.every < 1:
            raise ValueError("the number of images of which one is written must be at least 1")
        if self.rate_hz is not None and not 0 < self.rate_hz <= NS:
            raise ValueError("the rate of images must be above 0, and at most one a nanosecond")


class ImageFile(NamedTuple):
    """The bytes of a file, its suffix, and the size of its picture."""

    data: bytes | memoryview
    suffix: str
    width: int
    height: int


def why_no_images(message_type: str) -> str | None:
    """Return why the messages of a type are not written as images; None for a type that holds images."""
    kind = re.split(r"[/.:]", message_type)[-1]
    if kind in CAMERA_TYPES:
        return None
    return "it is a video, not single images" if kind in VIDEO_TYPES else f"its messages, {message_type}, are no images"


def write_images(
    group: TopicGroup, folder: Path, selection: Selection, options: ImageOptions, on_rows: OnRows
) -> Written:
    """Write the images of a topic to a new folder, which appears when it is complete.

    Until then it is `.NAME.part` beside it, which is removed after an error. Messages whose image cannot be written are
    counted. Without any image there is no folder.

    Raises:
        CannotWrite: the folder exists, or the folder above it cannot be written to or is full.
    """
    partial = folder.with_name(f".{folder.name}.part")
    try:
        refuse_existing(folder)
        with _locked_folder(partial):
            written = _fill(group, partial, selection, options, on_rows)
            if written.row_count:
                sync_folder(partial)
                partial.rename(folder)
                sync_folder(folder.parent)
            else:
                shutil.rmtree(partial)
    except BlockingIOError:
        raise CannotWrite(str(folder), "another process is writing it") from None
    except OSError as error:
        raise CannotWrite(str(folder), f"cannot be written: {error.strerror or error}") from error
    return written


@contextmanager
def _locked_folder(path: Path) -> Iterator[None]:
    """Make a folder, or empty one that a killed process left; after an error, remove it.

    Raises:
        BlockingIOError: another process has it.
    """
    path.mkdir(exist_ok=True)
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        lock(descriptor, path)
        try:
            for left in path.iterdir():
                left.unlink()
            yield
        except BaseException:
            shutil.rmtree(path, ignore_errors=True)
            raise
    finally:
        os.close(descriptor)


def _fill(group: TopicGroup, folder: Path, selection: Selection, options: ImageOptions, on_rows: OnRows) -> Written:
    frames = FrameNames()
    count = failed = size_bytes = 0
    failure = ""
    with (folder / INDEX_NAME).open("w", encoding="utf-8", newline="") as stream:
        index = csv.writer(stream, lineterminator="\r\n")
        index.writerow(_HEADERS)
        for one, (log_ns, _, data) in _selected(group, selection, options, on_rows):
            try:
                value = _decode(group.decoder, data)
                made = image_file(value, as_jpeg=options.as_jpeg)
                stamp = _stamp_of(value)
            except _BROKEN as error:
                failed += 1
                failure = failure or str(error)
                continue
            frame, encoding = _frame_of(value), _text(part(value, "encoding") or part(value, "format") or "")
            file_name = _write(folder, log_ns if stamp is None else stamp, made)
            index.writerow([stamp, log_ns, file_name, made.width, made.height, encoding, frame, one.name])
            frames.add(frame)
            count, size_bytes = count + 1, size_bytes + len(made.data)
        stream.flush()
        size_bytes += (folder / INDEX_NAME).stat().st_size
    return Written(count, size_bytes, frames.only, failed, failure)


def _decode(decoder: Decoder | Undecodable, data: bytes) -> object:
    if isinstance(decoder, Undecodable):
        raise DecodeError(decoder.type_name, decoder.reason)
    return decoder.decode(data)


def _frame_of(value: object) -> str | None:
    frame = part(part(value, "header"), "frame_id") if part(value, "header") is not None else part(value, "frame_id")
    return None if frame is None else _text(frame)


def _text(value: object) -> str:
    """Return a value as a text that UTF-8 can express: JSON may have half of a surrogate pair."""
    return str(value).encode("utf-8", "replace").decode()


def _stamp_of(value: object) -> int | None:
    stamp = stamp_ns(value)
    if stamp is not None and abs(stamp) >= END_OF_TIME_NS:
        raise DecodeError(type_name(value), "its stamp is beyond all times")
    return stamp


def _write(folder: Path, stamp: int, made: ImageFile) -> str:
    """Write a file named by a stamp, with a number behind it for further images of one stamp; return its name."""
    stem, number = f"{stamp:019d}", 1
    while True:
        name = f"{stem}.{made.suffix}" if number == 1 else f"{stem}-{number}.{made.suffix}"
        try:
            with (folder / name).open("xb") as file:
                file.write(made.data)
        except FileExistsError:
            number += 1
        else:
            return name


_Images = Iterator[tuple[NamedRecording, TimedMessage]]


def _selected(group: TopicGroup, selection: Selection, options: ImageOptions, on_rows: OnRows) -> _Images:
    """Yield the messages whose images are written, with their recordings."""
    if options.rate_hz is not None:
        yield from _spaced(group, selection, max(1, round(NS / options.rate_hz)), on_rows)
        return
    for number, item in enumerate(messages_of(group, selection)):
        on_rows(1)
        if number % options.every == 0:
            yield item


def _spaced(group: TopicGroup, selection: Selection, slot_ns: int, on_rows: OnRows) -> _Images:
    """Yield the first message of each slot of log time since the first message.

    Parts of the recordings that are between two of them are not read.
    """
    topic = group.topic.name
    segments = sorted(
        (one.first_ns, one.last_ns) for part in group.recordings for one in part.recording.segments(topic)
    )
    messages = messages_of(group, selection)
    first_ns, next_ns = None, 0
    while (item := next(messages, None)) is not None:
        on_rows(1)
        log_ns = item[1][0]
        if log_ns < next_ns:
            continue
        first_ns = log_ns if first_ns is None else first_ns
        yield item
        next_ns = first_ns + ((log_ns - first_ns) // slot_ns + 1) * slot_ns
        after = bisect_right(segments, (log_ns, END_OF_TIME_NS))
        if after < len(segments) and segments[after][1] < next_ns:
            messages = messages_of(group, selection._replace(start_ns=next_ns))


def image_file(value: object, *, as_jpeg: bool = False) -> ImageFile:
    """Return the image of a decoded message as a file (see the module).

    Raises:
        DecodeError: it has none, it is too large, or no format of files takes its pixels.
        ReadingExtraMissing: numpy or pillow is not installed.
    """
    if (compressed := compressed_image(value)) is not None:
        data, suffix, (width, height) = compressed
        return ImageFile(data, suffix, width, height)
    picture = image(value, max_pixels=MAX_PIXELS)
    height, width, channels = picture.shape
    if not picture.size:
        raise DecodeError(type_name(value), "the picture has no pixels")
    if _OPENCV_COLOUR.match(str(part(value, "encoding")).lower()):
        picture = picture[..., [2, 1, 0, *range(3, channels)]]  # OpenCV's order is BGR
    kind = picture.dtype.name
    if kind == "uint8" and as_jpeg and channels in (1, 3):
        return ImageFile(_pillow_file(picture, "JPEG", quality=_JPEG_QUALITY), "jpg", width, height)
    if kind in ("uint8", "uint16") and channels in _PNG_COLOURS:
        return ImageFile(_png(picture), "png", width, height)
    if kind in ("float32", "int32") and channels == 1:
        return ImageFile(_pillow_file(picture, "TIFF"), "tiff", width, height)
    raise DecodeError(type_name(value), f"pixels of {channels} {kind} have no format of image files")


def _pillow_file(picture: NDArray[Any], file_format: str, **options: int) -> bytes:
    import numpy as np
    from PIL import Image

    out = io.BytesIO()
    plane = picture[..., 0] if picture.shape[2] == 1 else picture
    try:
        Image.fromarray(np.ascontiguousarray(plane)).save(out, file_format, **options)
    except (OSError, SystemError) as error:  # such as a JPEG of more than 65,535 columns
        raise DecodeError("", f"its image cannot be written as {file_format}: {str(error)[:100]}") from None
    return out.getvalue()


def _png(picture: NDArray[Any]) -> bytes:
    """Return pixels of 8 or 16 bits as a PNG; Pillow has none of 16 bits in colour.

    Source: PNG specification (third edition), 5.3 chunk layout, 11.2.1 IHDR, 9.2 filter type Sub.
    """
    import numpy as np

    height, width, channels = picture.shape
    rows = np.ascontiguousarray(picture, picture.dtype.newbyteorder(">")).view(np.uint8).reshape(height, -1)
    pixel_bytes = channels * picture.dtype.itemsize
    filtered = np.empty((height, rows.shape[1] + 1), np.uint8)
    filtered[:, 0] = 1  # Sub: each byte less that of the pixel at the left
    filtered[:, 1:] = rows
    filtered[:, 1 + pixel_bytes :] -= rows[:, :-pixel_bytes]
    colour = _PNG_COLOURS[channels]
    header = struct.pack(">IIBBBBB", width, height, 8 * picture.dtype.itemsize, colour, 0, 0, 0)
    pixels = zlib.compress(filtered.tobytes(), _PNG_LEVEL)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", pixels) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
