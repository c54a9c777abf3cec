"""Bytes of a recording -> facts about it: ROS 1 bag, MCAP, rosbag2.

Pure: a source is "read these bytes at this offset". Bounded memory, no database, nothing of ours outside this
package. Files are untrusted: whatever their bytes, the answer is a summary (`summarise`), and a server lets a child
process give it (`summarise_isolated`).

Names are imported when they are first used, so that `klein --help` does not pay for reading recordings.

Submodules: `reading` (messages), `inspect`, `isolation`, `http_source`, and `sample`, which makes sample missions.
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
    from kleinkram.recordings.grouping import RecordingGroup, RecordingGroupKind, group, is_recording_name
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
    "Content",
    "CountingSource",
    "Depth",
    "Fact",
    "FailureKind",
    "FileRequest",
    "FileSource",
    "Lost",
    "MemberFacts",
    "Problem",
    "RecordingError",
    "RecordingFormat",
    "RecordingGroup",
    "RecordingGroupKind",
    "RecordingSummary",
    "Rosbag2Metadata",
    "SequentialReader",
    "Source",
    "SourceError",
    "StreamRequest",
    "SummaryFailed",
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
    "grouping": ("RecordingGroupKind", "RecordingGroup", "group", "is_recording_name"),
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
