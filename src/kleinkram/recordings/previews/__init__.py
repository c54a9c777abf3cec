"""Previews of recordings: what a viewer shows of a recording before it reads any of its bytes.

`make_preview` reads a recording once and returns one small file (docs/formats.md), which `read_preview` parses. Memory
stays below about 300 MB, whatever the recording. Needs numpy and pillow, of the extra `reading`.
"""

from kleinkram.recordings.previews.builder import PreviewLimits, make_preview, preview_max_bytes
from kleinkram.recordings.previews.container import (
    PREVIEW_VERSION,
    PreviewUnreadable,
    first_position,
    read_preview,
    representative_thumbnail,
)
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

__all__ = [
    "PREVIEW_VERSION",
    "CameraStrip",
    "FieldSeries",
    "LeftOutTopic",
    "LogLine",
    "LogSeverity",
    "PositionTrack",
    "PreviewLimits",
    "PreviewUnreadable",
    "RecordingPreview",
    "ThinnedCloud",
    "Thumbnail",
    "TopicSeries",
    "TrackKind",
    "first_position",
    "make_preview",
    "preview_max_bytes",
    "read_preview",
    "representative_thumbnail",
]
