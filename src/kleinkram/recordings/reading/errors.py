"""What can go wrong when a recording is opened or asked, by name."""

from __future__ import annotations

from kleinkram.recordings.errors import RecordingError

_SHOWN = 20


class NotARecording(RecordingError):
    """What was to be opened holds no messages, or none of a format that we read.

    Attributes:
        name: of the file or folder.
    """

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name


class SeveralRecordings(RecordingError):
    """A folder holds more than one recording, so it cannot be told which is meant.

    Attributes:
        names: of the recordings.
    """

    def __init__(self, folder: str, names: list[str]) -> None:
        shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
        super().__init__(f"{folder} holds {len(names)} recordings; open one of them: {shown}")
        self.names = names


class TooCostly(RecordingError):
    """A file without an index that can be used would have to be read whole, and that was not allowed.

    Attributes:
        name: of the file.
        size_bytes: what reading it would cost.
    """

    def __init__(self, name: str, size_bytes: int, why: str) -> None:
        super().__init__(
            f"{name}: {why}; to open it, all its {size_bytes} bytes must be read first: "
            f"allow that with most_bytes={size_bytes}, or download the file and open it from there"
        )
        self.name = name
        self.size_bytes = size_bytes


class NoSuchTopic(RecordingError):
    """The recording has no topic of that name.

    Attributes:
        topic: the name.
        topics: those that it has.
    """

    def __init__(self, topic: str, topics: list[str]) -> None:
        shown = ", ".join(topics[:_SHOWN]) + (", ..." if len(topics) > _SHOWN else "")
        super().__init__(f"there is no topic {topic}; the recording has {shown or 'none'}")
        self.topic = topic
        self.topics = topics
