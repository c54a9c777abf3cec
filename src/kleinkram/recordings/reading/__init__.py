"""Reading the messages of a recording, wherever its files are: `Recording.open`.

In the order of log time, raw or decoded, of some topics or a span of time, from a path, a folder, or any sources.
Reads only what it needs, in bounded memory; nothing that a file holds raises.
"""

from kleinkram.recordings.reading.errors import NoSuchTopic, NotARecording, SeveralRecordings, TooCostly
from kleinkram.recordings.reading.merging import TooDisordered
from kleinkram.recordings.reading.model import Channel, Message, RawMessage, Schema, Topic
from kleinkram.recordings.reading.recording import Recording

__all__ = [
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
]
