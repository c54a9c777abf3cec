"""Reads recordings (MCAP, ROS 1 bag, rosbag2, ULog): summaries (`summarise`, `scan`) and messages (`Recording`).

`Recording` also writes them as MCAP, ROS 1 bag, Parquet, CSV and images.

Independent of the rest of Kleinkram: it reads bytes from a source, in bounded memory, without a database. Files are
untrusted: any bytes give a summary. A server reads them in a child process (`isolation`).

Names are imported when they are first used, so that `klein --help` does not pay for reading recordings.
"""

# mypy: implicit-reexport
# ruff: noqa: F401

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kleinkram.recordings.combine_summaries import combine
    from kleinkram.recordings.errors import (
        CannotWrite,
        EmptyRange,
        FailureKind,
        NoSuchTopic,
        NotARecording,
        NotConvertible,
        OutsideRecording,
        RecordingError,
        SeveralRecordings,
        SourceError,
        SummaryFailed,
        TooCostly,
        TooDisordered,
    )
    from kleinkram.recordings.messages import Channel, Message, RawMessage, Schema, Topic
    from kleinkram.recordings.model import (
        Content,
        Depth,
        Fact,
        Lost,
        Problem,
        RecordingFormat,
        RecordingSummary,
        TopicSummary,
    )
    from kleinkram.recordings.recording import Recording
    from kleinkram.recordings.recording_groups import RecordingGroup, RecordingGroupKind, group, is_recording_name
    from kleinkram.recordings.sources import FileSource, Source
    from kleinkram.recordings.summary import scan, summarise
    from kleinkram.recordings.writing.bag import BagCompression, BagOptions, BagResult
    from kleinkram.recordings.writing.export import (
        ExportedFile,
        ExportFormat,
        ExportOptions,
        ExportResult,
        RecordingProblem,
        TopicLeftOut,
        export_recordings,
    )
    from kleinkram.recordings.writing.image_files import ImageOptions
    from kleinkram.recordings.writing.losses import LostPlace, MemberLoss
    from kleinkram.recordings.writing.mcap import (
        ChunkCompression,
        McapOptions,
        McapResult,
        Ros1Messages,
        is_whole_mcap,
        merge_to_mcap,
    )
    from kleinkram.recordings.writing.message_copy import LeftOut
    from kleinkram.recordings.writing.topic_rows import NamedRecording

_HOMES = {
    "combine_summaries": "combine",
    "errors": "CannotWrite EmptyRange FailureKind NoSuchTopic NotARecording NotConvertible OutsideRecording "
    "RecordingError SeveralRecordings SourceError SummaryFailed TooCostly TooDisordered",
    "messages": "Channel Message RawMessage Schema Topic",
    "model": "Content Depth Fact Lost Problem RecordingFormat RecordingSummary TopicSummary",
    "recording": "Recording",
    "recording_groups": "RecordingGroup RecordingGroupKind group is_recording_name",
    "sources": "FileSource Source",
    "summary": "scan summarise",
    "writing.bag": "BagCompression BagOptions BagResult",
    "writing.export": "ExportFormat ExportOptions ExportResult ExportedFile RecordingProblem TopicLeftOut "
    "export_recordings",
    "writing.image_files": "ImageOptions",
    "writing.losses": "MemberLoss LostPlace",
    "writing.mcap": "ChunkCompression McapOptions McapResult Ros1Messages is_whole_mcap merge_to_mcap",
    "writing.message_copy": "LeftOut",
    "writing.topic_rows": "NamedRecording",
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names.split()}
__all__ = sorted(_HOME_OF)


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
