"""Messages and rows of one topic over all recordings of a mission, in the order of log time.

Memory: a batch of messages, and what `Recording` holds of each recording whose times overlap.
"""

from __future__ import annotations

import functools
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush, heapreplace
from typing import Any, NamedTuple

from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, arrow_batches
from kleinkram.recordings.decoding.tables import TIME_COLUMNS, TimedMessage, load_pyarrow
from kleinkram.recordings.decoding.types import Layout, Struct
from kleinkram.recordings.messages import Selection, Topic
from kleinkram.recordings.recording import Recording, decoder_of
from kleinkram.recordings.writing.units import units_of

BATCH_BYTES = 4 * 2**20
"""Bytes of messages of one batch; a larger message is a batch of its own."""

RECORDING = "recording"
"""Name of the column with the name of the recording of a row."""

_VARYING = ("json", "protobuf")  # encodings whose batches have the columns that their messages need
_UNSAFE = re.compile(r"[^\w.-]+", re.ASCII)
_MAX_NAME = 200


OnRows = Callable[[int], None]
"""Called with the number of messages that were just written."""


class NamedRecording(NamedTuple):
    """An opened recording, and its name in the mission."""

    name: str
    recording: Recording


class Written(NamedTuple):
    """What was written of a topic.

    Attributes:
        row_count: rows or images.
        size_bytes: of the file, or of all files of a folder.
        frame_id: of all messages; None where it differs, or where they have none.
        failed_count: messages that are no images that can be written; `failure`: why the first is none.
    """

    row_count: int
    size_bytes: int
    frame_id: str | None = None
    failed_count: int = 0
    failure: str = ""


@dataclass(frozen=True)
class TopicGroup:
    """A topic of one message layout, and the recordings of a mission that have it.

    Attributes:
        name: of its file, without suffix; no two groups of a mission have the same.
        topic: as the first of the recordings has it.
        recordings: in the order of the mission.
        message_count: None where messages would have to be read to be counted.
        with_recording: whether rows have the column `recording`.
    """

    name: str
    topic: Topic
    recordings: tuple[NamedRecording, ...]
    message_count: int | None
    with_recording: bool

    @functools.cached_property
    def decoder(self) -> Decoder | Undecodable:
        """The decoder of its messages."""
        return decoder_of(self.topic.message_encoding, self.topic.schema)

    @property
    def struct(self) -> Struct | None:
        """The type of the messages; None where the messages decide on their columns, and for undecodable topics."""
        return self.decoder.struct if isinstance(self.decoder, Decoder) else None

    def units(self) -> dict[str, str]:
        """Return the units of its columns, by their names in `to_arrow`."""
        own = {} if self.struct is None else units_of(self.struct)
        return dict.fromkeys(TIME_COLUMNS, "ns") | own


def sources_of(recordings: Iterable[NamedRecording]) -> dict[str, dict[str, str | None]]:
    """Return the files of each recording, with their SHA-256 where it is known: of files on a server."""
    return {one.name: {file: one.recording.sha256.get(file) for file in one.recording.files} for one in recordings}


def group_topics(
    recordings: Sequence[NamedRecording], selection: Selection, *, with_recording: bool
) -> list[TopicGroup]:
    """Return the selected topics of all recordings, by name; a topic of several layouts is several groups."""
    members: dict[tuple[object, ...], list[tuple[NamedRecording, Topic]]] = {}
    for one in recordings:
        for topic in one.recording.topics:
            if selection.has_topic(topic.name):
                kind = topic.message_type.replace("/msg/", "/"), topic.message_encoding, _layout_of(topic)
                members.setdefault((topic.name, *kind), []).append((one, topic))
    groups: list[TopicGroup] = []
    taken = {"index.json"}  # of the export
    for pairs in sorted(members.values(), key=lambda pairs: (pairs[0][1].name, pairs[0][1].undecodable is not None)):
        counts = [topic.count for _, topic in pairs]
        total = None if None in counts else sum(count or 0 for count in counts)
        parts = tuple(one for one, _ in pairs)
        groups.append(TopicGroup(_file_name(pairs[0][1].name, taken), pairs[0][1], parts, total, with_recording))
    return groups


def _layout_of(topic: Topic) -> Layout | None:
    decoder = decoder_of(topic.message_encoding, topic.schema)
    return decoder.layout if isinstance(decoder, Decoder) else None


def _file_name(topic: str, taken: set[str]) -> str:
    """Return a name for the file of a topic that is not taken, also where case does not count."""
    stem = _UNSAFE.sub("_", topic.strip("/").replace("/", "."))[:_MAX_NAME].lstrip(".") or "topic"
    name, number = stem, 1
    while name.lower() in taken:
        number += 1
        name = f"{stem}-{number}"
    taken.add(name.lower())
    return name


def messages_of(group: TopicGroup, selection: Selection) -> Iterator[tuple[NamedRecording, TimedMessage]]:
    """Yield the messages of a group by log time; of equal times, in the order of the recordings.

    A recording is read from once its first log time is reached.
    """
    waiting = sorted(enumerate(group.recordings), key=lambda item: item[1].recording.start_ns or 0, reverse=True)
    heap: list[tuple[int, int, TimedMessage, Iterator[TimedMessage]]] = []
    while waiting or heap:
        if waiting and (not heap or (waiting[-1][1].recording.start_ns or 0) <= heap[0][0]):
            number, one = waiting.pop()
            messages = one.recording.topic_messages(group.topic.name, start=selection.start_ns, end=selection.end_ns)
            if (message := next(messages, None)) is not None:
                heappush(heap, (message[0], number, message, messages))
            continue
        _, number, message, messages = heap[0]
        yield group.recordings[number], message
        if (following := next(messages, None)) is None:
            heappop(heap)
        else:
            heapreplace(heap, (following[0], number, following, messages))


def schema_of(group: TopicGroup, selection: Selection) -> Any:
    """Return the Arrow schema of the rows of a group.

    Reads the messages of JSON and protobuf, whose columns depend on them.

    Raises:
        pyarrow.ArrowException: the columns of batches contradict each other.
    """
    pa = load_pyarrow()

    def unified(one: Any, other: Any) -> Any:
        return pa.unify_schemas([one, other], promote_options="permissive")

    if group.topic.message_encoding in _VARYING:
        return functools.reduce(unified, (table.schema for table in _tables(group, selection)))
    return next(_tables(group, Selection(None, 0, 0))).schema


def rows_of(group: TopicGroup, schema: Any, selection: Selection) -> Iterator[Any]:
    """Yield the rows of a group as tables with this schema, which follow each other in log time.

    At least one table, which may be empty. With `with_recording`, the third column is `recording`.
    """
    import pyarrow as pa

    for table in _tables(group, selection):
        if not table.schema.equals(schema):
            table = pa.concat_tables([schema.empty_table(), table], promote_options="permissive")
        yield table
        del table


def _tables(group: TopicGroup, selection: Selection) -> Iterator[Any]:
    import pyarrow as pa

    pending: deque[tuple[int, NamedRecording]] = deque()  # log times and recordings of messages that have no row yet

    def timed() -> Iterator[TimedMessage]:
        for one, message in messages_of(group, selection):
            pending.append((message[0], one))
            yield message

    def notice(log_time_ns: int, error: DecodeError) -> None:
        one = next((one for log_ns, one in pending if log_ns == log_time_ns), group.recordings[0])
        one.recording.note_undecodable(group.topic.name, log_time_ns, error)

    for batch in arrow_batches(group.decoder, timed(), notice=notice, batch_bytes=BATCH_BYTES):
        table = pa.Table.from_batches([batch])
        del batch
        names = [pending.popleft()[1].name for _ in range(table.num_rows)]
        if group.with_recording:
            table = _with_names(table, pa.array(names, pa.string()))
        yield table
        del table


def _with_names(table: Any, names: Any) -> Any:
    """Return rows with the names of their recordings; a field of the messages with the column's name gets another."""
    others = [unused_name(name, table.column_names) if name == RECORDING else name for name in table.column_names]
    return table.rename_columns(others).add_column(len(TIME_COLUMNS), RECORDING, names)


def unused_name(name: str, taken: Iterable[str]) -> str:
    """Return a column's name, with a "_" behind it for each time that a field of the messages has it."""
    names = set(taken)
    while name in names:
        name += "_"
    return name


class FrameNames:
    """The frames of the rows of a topic: one, or several."""

    def __init__(self) -> None:
        self._names: set[str | None] = set()

    def note(self, table: Any) -> None:
        """Take the frames of some rows."""
        for column in ("header.frame_id", "frame_id"):
            if len(self._names) < 2 and column in table.column_names:  # two are as good as many
                self._names.update(table[column].unique().to_pylist())

    def add(self, name: str | None) -> None:
        """Take the frame of one message."""
        if len(self._names) < 2:
            self._names.add(name)

    @property
    def only(self) -> str | None:
        """The frame of all rows; None for several or none."""
        (name,) = self._names if len(self._names) == 1 else (None,)
        return name
