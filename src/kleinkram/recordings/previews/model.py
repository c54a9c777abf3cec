"""What a preview contains. Times are log times, nanoseconds since 1970."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class FieldSeries:
    """The range of a numeric field in each bin of its topic.

    Attributes:
        name: path of the field, such as `linear_acceleration.x` or `position[2]`.
        low: float64 [bins], least value in the unit of the field; NaN for a bin without a number.
        high: float64 [bins], greatest value.
    """

    name: str
    low: NDArray[np.float64]
    high: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TopicSeries:
    """The numeric fields of a topic, in bins of equally many consecutive messages.

    Bins count messages instead of time, so that one wrong clock does not put all messages into one bin.

    Attributes:
        message_count: messages in all bins; the last bin has the rest of a division by `messages_per_bin`.
        first_ns: int64 [bins], time of the first message of each bin.
        last_ns: int64 [bins], time of the last message of each bin.
        is_sampled: not every message was decoded, so that an extreme value may be missing.
    """

    topic: str
    message_type: str
    message_count: int
    messages_per_bin: int
    first_ns: NDArray[np.int64]
    last_ns: NDArray[np.int64]
    fields: tuple[FieldSeries, ...]
    is_sampled: bool


@dataclass(frozen=True)
class Thumbnail:
    """A small picture of a camera, as JPEG."""

    time_ns: int
    width: int
    height: int
    jpeg: bytes


@dataclass(frozen=True)
class CameraStrip:
    """Thumbnails of a camera, evenly spread over its messages. `message_count`: messages that were counted."""

    topic: str
    message_count: int
    thumbnails: tuple[Thumbnail, ...]


class TrackKind(str, Enum):
    """What the positions of a track are."""

    gnss = "gnss"  # latitude and longitude in degrees (WGS 84), altitude in metres
    pose = "pose"  # x, y, z in metres, in the frame of the topic


@dataclass(frozen=True, eq=False)
class PositionTrack:
    """Thinned positions of a topic.

    Attributes:
        message_count: positions that the topic has; those without fix or that are not finite are left out.
        times_ns: int64 [N].
        positions: float64 [N, 3], as `kind` says; NaN for an altitude that is unknown.
    """

    topic: str
    kind: TrackKind
    message_count: int
    times_ns: NDArray[np.int64]
    positions: NDArray[np.float64]


class LogSeverity(str, Enum):
    """Severity of a line, of ROS 1, ROS 2, Foxglove and diagnostics alike."""

    unknown = "unknown"
    debug = "debug"
    info = "info"
    warning = "warning"
    error = "error"
    fatal = "fatal"


@dataclass(frozen=True)
class LogLine:
    """A text of a log, or a diagnostic status that changed. `source`: name of the node or of the status."""

    time_ns: int
    topic: str
    severity: LogSeverity
    source: str
    text: str


@dataclass(frozen=True, eq=False)
class ThinnedCloud:
    """Some points of one cloud.

    Attributes:
        point_count: points of the whole cloud.
        xyz: float32 [N, 3], metres, frame `frame_id`.
    """

    topic: str
    time_ns: int
    frame_id: str
    point_count: int
    xyz: NDArray[np.float32]


@dataclass(frozen=True)
class LeftOutTopic:
    """A topic of which something is not in the preview, and why."""

    topic: str
    reason: str


@dataclass(frozen=True)
class RecordingPreview:
    """A parsed preview.

    Attributes:
        start_ns: earliest time of a message that was read; None without messages.
        end_ns: latest time.
        read_share: share of the recording that was read, from 0 to 1; below 1, all contents are samples.
        read_spans: int64 [N, 2], earliest and latest log time of each part that was read of a recording that was not
            read as a whole, in order and apart from each other; nothing is known of the times between. Empty where the
            whole recording was read, or its beginning.
        log_line_count: lines and statuses in all, of which `log_lines` are the first and the most severe.
    """

    start_ns: int | None
    end_ns: int | None
    read_share: float
    series: tuple[TopicSeries, ...]
    cameras: tuple[CameraStrip, ...]
    tracks: tuple[PositionTrack, ...]
    log_lines: tuple[LogLine, ...]
    log_line_count: int
    clouds: tuple[ThinnedCloud, ...]
    left_out: tuple[LeftOutTopic, ...]
    read_spans: NDArray[np.int64]
