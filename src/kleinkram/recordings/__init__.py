"""Bytes of a recording -> facts about it: ROS 1 bag, MCAP, rosbag2.

Pure: a source is "read these bytes at this offset". Bounded memory, no database, nothing of ours outside this
package. Files are untrusted: whatever their bytes, the answer is a summary (`summarise`), and a server lets a child
process give it (`summarise_isolated`).

Submodules: `grouping`, `combining`, `inspect`, `isolation`, `rosbag2_metadata`, `http_source` (needs urllib3) and
`sample`, which makes sample missions.
"""

from kleinkram.recordings.combining import combine
from kleinkram.recordings.errors import FailureKind, RecordingError, SourceError, SummaryFailed
from kleinkram.recordings.grouping import GroupKind, RecordingGroup, group, is_recording_name
from kleinkram.recordings.isolation import (
    CHILD_COMMAND,
    CHILD_ENVIRONMENT,
    FileRequest,
    UrlRequest,
    read_answer,
    request_bytes,
    summarise_isolated,
    timed_out,
)
from kleinkram.recordings.model import Content, Problem, RecordingFormat, RecordingSummary, TopicSummary
from kleinkram.recordings.rosbag2_metadata import Rosbag2Metadata, parse_rosbag2_metadata
from kleinkram.recordings.serialise import from_dict, to_dict
from kleinkram.recordings.sniffing import sniff
from kleinkram.recordings.sources import CountingSource, FileSource, Source
from kleinkram.recordings.summary import summarise

__all__ = [
    "CHILD_COMMAND",
    "CHILD_ENVIRONMENT",
    "Content",
    "CountingSource",
    "FailureKind",
    "FileRequest",
    "FileSource",
    "GroupKind",
    "Problem",
    "RecordingError",
    "RecordingFormat",
    "RecordingGroup",
    "RecordingSummary",
    "Rosbag2Metadata",
    "Source",
    "SourceError",
    "SummaryFailed",
    "TopicSummary",
    "UrlRequest",
    "combine",
    "from_dict",
    "group",
    "is_recording_name",
    "parse_rosbag2_metadata",
    "read_answer",
    "request_bytes",
    "sniff",
    "summarise",
    "summarise_isolated",
    "timed_out",
    "to_dict",
]
