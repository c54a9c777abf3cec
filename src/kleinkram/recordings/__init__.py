"""Recordings (MCAP, ROS 1 bag, rosbag2, ULog): what is in them (`summarise`, `scan`), and their messages (`Recording`).

Independent of the rest of Kleinkram: it reads bytes from a source, in bounded memory, without a database. Files are
untrusted: whatever their bytes, the answer is a summary. A server reads them in a child process (`isolation`).

Names are imported when they are first used, so that `klein --help` does not pay for reading recordings.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kleinkram.recordings.combine_summaries import combine
    from kleinkram.recordings.errors import FailureKind, RecordingError, SourceError, SummaryFailed
    from kleinkram.recordings.formats.registry import sniff
    from kleinkram.recordings.formats.rosbag2.metadata import (
        MemberFacts,
        Rosbag2Metadata,
        TopicFacts,
        compare_metadata,
        parse_rosbag2_metadata,
    )
    from kleinkram.recordings.isolation import (
        CHILD_COMMAND,
        CHILD_ENVIRONMENT,
        FileRequest,
        StreamRequest,
        UrlRequest,
        from_dict,
        metadata_request_bytes,
        read_answer,
        read_metadata_answer,
        request_bytes,
        stream_request_bytes,
        summarise_isolated,
        timed_out,
        to_dict,
    )
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
    from kleinkram.recordings.recording import (
        Channel,
        Message,
        NoSuchTopic,
        NotARecording,
        RawMessage,
        Recording,
        Schema,
        SeveralRecordings,
        TooCostly,
        TooDisordered,
        Topic,
    )
    from kleinkram.recordings.recording_groups import RecordingGroup, RecordingGroupKind, group, is_recording_name
    from kleinkram.recordings.sources import (
        CountingSource,
        FileSource,
        SequentialReader,
        Source,
        file_reader,
        pipe_reader,
        source_reader,
    )
    from kleinkram.recordings.summary import scan, summarise

__all__ = [
    "CHILD_COMMAND",
    "CHILD_ENVIRONMENT",
    "Channel",
    "Content",
    "CountingSource",
    "Depth",
    "Fact",
    "FailureKind",
    "FileRequest",
    "FileSource",
    "Lost",
    "MemberFacts",
    "Message",
    "NoSuchTopic",
    "NotARecording",
    "Problem",
    "RawMessage",
    "Recording",
    "RecordingError",
    "RecordingFormat",
    "RecordingGroup",
    "RecordingGroupKind",
    "RecordingSummary",
    "Rosbag2Metadata",
    "Schema",
    "SequentialReader",
    "SeveralRecordings",
    "Source",
    "SourceError",
    "StreamRequest",
    "SummaryFailed",
    "TooCostly",
    "TooDisordered",
    "Topic",
    "TopicFacts",
    "TopicSummary",
    "UrlRequest",
    "combine",
    "compare_metadata",
    "file_reader",
    "from_dict",
    "group",
    "is_recording_name",
    "metadata_request_bytes",
    "parse_rosbag2_metadata",
    "pipe_reader",
    "read_answer",
    "read_metadata_answer",
    "request_bytes",
    "scan",
    "sniff",
    "source_reader",
    "stream_request_bytes",
    "summarise",
    "summarise_isolated",
    "timed_out",
    "to_dict",
]

_HOMES = {
    "recording": (
        "Channel",
        "Message",
        "NoSuchTopic",
        "NotARecording",
        "RawMessage",
        "Recording",
        "Schema",
        "SeveralRecordings",
        "TooCostly",
        "TooDisordered",
        "Topic",
    ),
    "combine_summaries": ("combine",),
    "errors": ("FailureKind", "RecordingError", "SourceError", "SummaryFailed"),
    "sources": (
        "CountingSource",
        "FileSource",
        "SequentialReader",
        "Source",
        "file_reader",
        "pipe_reader",
        "source_reader",
    ),
    "recording_groups": ("RecordingGroupKind", "RecordingGroup", "group", "is_recording_name"),
    "isolation": (
        "CHILD_COMMAND",
        "CHILD_ENVIRONMENT",
        "FileRequest",
        "StreamRequest",
        "UrlRequest",
        "from_dict",
        "to_dict",
        "metadata_request_bytes",
        "read_answer",
        "read_metadata_answer",
        "request_bytes",
        "stream_request_bytes",
        "summarise_isolated",
        "timed_out",
    ),
    "model": ("Content", "Depth", "Fact", "Lost", "Problem", "RecordingFormat", "RecordingSummary", "TopicSummary"),
    "formats.rosbag2.metadata": (
        "MemberFacts",
        "Rosbag2Metadata",
        "TopicFacts",
        "compare_metadata",
        "parse_rosbag2_metadata",
    ),
    "formats.registry": ("sniff",),
    "summary": ("scan", "summarise"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
