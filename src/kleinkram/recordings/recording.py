"""`Recording`: the messages of one recording, by log time, wherever its files are.

Memory stays below about 200 MB whatever the size of the files. A recording can be read several times; iterations are
independent. Do not share it between threads.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from html import escape
from os import PathLike
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from kleinkram.recordings import decoding
from kleinkram.recordings.chunk_reader import MAX_MESSAGE
from kleinkram.recordings.compression import unpack_message
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable
from kleinkram.recordings.decoding.types import BATCH_BYTES
from kleinkram.recordings.errors import Malformed, NoSuchTopic, SourceError
from kleinkram.recordings.formats.base import MemberContents, OpenedFile, Segment
from kleinkram.recordings.formats.ulog import as_ros1_definition
from kleinkram.recordings.merge_messages import MessagePiece, merge
from kleinkram.recordings.messages import (
    Block,
    Channel,
    Message,
    RawMessage,
    Schema,
    Selection,
    Time,
    Topic,
)
from kleinkram.recordings.model import Problem, RecordingSummary
from kleinkram.recordings.recording_files import Openable, open_members
from kleinkram.recordings.sources import FileSource
from kleinkram.recordings.time_range import resolve_range

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from kleinkram.recordings.writing.mcap import McapOptions, McapResult
    from kleinkram.recordings.writing.parquet import ParquetResult

OnProgress = Callable[[float], None]
Topics = str | Sequence[str]  # names of topics, or globs of them (`*`, `?`)


class Recording:
    """The files of one recording, opened for reading by `open`. Close it, or use it in a `with`.

    Attributes:
        name: of the file or folder.
        files: names of the data files, in the order of recording.
        topics: by name.
        message_count: None where they would have to be read to be counted.
    """

    def __init__(self, what: Openable, max_bytes: int | None) -> None:
        self.problem_log = ProblemLog()
        opened = open_members(what, self.problem_log, max_bytes=max_bytes)
        self.name, self.files = opened.name, opened.files
        self._members, self._sources = opened.members, opened.sources
        self._stack = opened.stack
        self._summarise, self._scan_files = opened.summarise, opened.scan_files
        self._summary_problems: tuple[Problem, ...] | None = None
        self._is_closed = False
        self._opened_from = Path(what).absolute() if isinstance(what, str | PathLike) else what, max_bytes
        contents = [member.contents for member in opened.members]
        counts = [content.message_count for content in contents]
        self.topics: tuple[Topic, ...] = _list_topics(contents)
        self.message_count = None if None in counts else sum(count for count in counts if count is not None)

    @classmethod
    def open(cls, what: Openable, *, max_bytes: int | None = None) -> Recording:
        """Open a file, a rosbag2 folder or its metadata.yaml, one or several sources, or an object with `sources()`.

        Reads the index only. A file without index, or with one that cannot be true, is read once from end to end;
        its damaged parts are left out and listed in `problems`. A db3, and a file that is compressed as a whole, is
        copied to this machine if it is not a plain local file.

        Args:
            what: the recording.
            max_bytes: a file with more bytes than this is not read whole; None: a local file is, whatever its size,
                and any other up to `MAX_REMOTE_SCAN_BYTES` (1 GiB).

        Raises:
            TooCostly: a file would have to be read whole, and has more bytes than are allowed.
            FileNotFoundError: there is no such file or folder.
            NotARecording: it holds no messages that we read.
            SeveralRecordings: the folder holds several.
            SourceError: the bytes cannot be read.
        """
        return cls(what, max_bytes)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the path or sources; unpickling opens them again."""
        return Recording, self._opened_from

    def _repr_html_(self) -> str:
        """Return its topics as a table, for notebooks."""
        cells = [(topic.name, topic.message_type, "" if topic.count is None else topic.count) for topic in self.topics]
        rows = "".join(f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in cells)
        heading = "<tr><th>topic</th><th>type</th><th>messages</th></tr>"
        return f"<table><caption>{escape(self.name)}</caption>{heading}{rows}</table>"

    @property
    def start_ns(self) -> int | None:
        """Earliest log time by the index, inclusive; None without messages."""
        starts = (member.contents.start_ns for member in self._members)
        return min((start_ns for start_ns in starts if start_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        """Latest log time by the index, inclusive; None without messages."""
        ends = (member.contents.end_ns for member in self._members)
        return max((end_ns for end_ns in ends if end_ns is not None), default=None)

    @property
    def problems(self) -> tuple[Problem, ...]:
        """All problems that `klein inspect` reports, and those met while messages were read.

        The first time, this reads what a summary reads and reading messages does not: message indexes of an MCAP, index
        data of a bag, all rows of a database. Once closed, a recording that was not opened by path has only the
        problems known then.
        """
        if self._summary_problems is None:
            try:
                self._summary_problems = self._summarise().problems
            except SourceError:
                if not self._is_closed:
                    raise
        return self.problem_log.all(self._summary_problems or ())

    @property
    def members(self) -> tuple[OpenedFile, ...]:
        """The opened data files, in the order of `files`; for modules of `kleinkram.recordings`."""
        return self._members

    @property
    def sha256(self) -> dict[str, str]:
        """SHA-256 of the files by name, where their sources know it: of files on a server, not of local ones."""
        known = ((PurePosixPath(source.name).name, getattr(source, "sha256", None)) for source in self._sources)
        return {name: sha256 for name, sha256 in known if sha256}

    @property
    def is_damaged(self) -> bool:
        """Return whether something damaged was met so far, when it was opened or read. Reads nothing."""
        return bool(self.damage) or any(member.summary is not None and member.summary.lost for member in self._members)

    def check_unchanged(self) -> None:
        """Raise `SourceError` if a local file was written to since the recording was opened."""
        for source in self._sources:
            if isinstance(source, FileSource):
                source.check_unchanged()

    def scan_files(self) -> tuple[RecordingSummary, ...]:
        """Return what is in each of `files` by reading all of it, with every checksum, as `klein inspect --deep`.

        Raises:
            SourceError: the bytes cannot be read.
        """
        return self._scan_files()

    @property
    def damage(self) -> tuple[Problem, ...]:
        """The damaged parts that were met so far: they were left out, or only partly read. Reads nothing."""
        return tuple(problem for problem in self.problem_log.all() if problem.code in _DAMAGED)

    def raw_messages(
        self, topics: Topics | None = None, *, start: Time | None = None, end: Time | None = None
    ) -> Iterator[RawMessage]:
        """Yield messages as bytes, in the order of log time; of equal times, in the order of the files.

        Args:
            topics: names or globs; None: all.
            start: earliest log time, inclusive: nanoseconds, an aware datetime, ISO text such as 2026-05-01T10:00Z, or
                a text of `resolve_time` such as 10:00 or +20s.
            end: latest log time, exclusive.

        Raises:
            NoSuchTopic: a name that is no glob is not among the topics.
            TooDisordered: too many parts overlap in time to be put in order in bounded memory.
            SourceError: the bytes cannot be read. The content of a file never raises.
        """
        blocks = self._blocks(self._select(topics, start, end))
        return (message for block in blocks for message in block)

    def messages(
        self, topics: Topics | None = None, *, start: Time | None = None, end: Time | None = None
    ) -> Iterator[Message]:
        """Yield decoded messages; arguments, order and errors are those of `raw_messages`.

        A message whose schema cannot be decoded has its bytes as value (the topic's `undecodable` says why); so has
        one that does not fit its schema, which is then named in `problems`.
        """
        return _decode_blocks(self._blocks(self._select(topics, start, end)), self.problem_log)

    def segments(self, topics: Topics | None = None) -> list[Segment]:
        """Return the parts of the recording that may hold messages of these topics, by first time.

        A segment is read as a whole: to look into a large recording, read some of its segments. Reads the index only.

        Raises:
            NoSuchTopic: a name that is no glob is not among the topics.
            SourceError: the bytes cannot be read.
        """
        selection = self._select(topics, None, None)
        parts = (member.segments(selection, number) for number, member in enumerate(self._members))
        return list(heapq.merge(*parts, key=lambda segment: segment.first_ns))

    def segment_messages(self, segment: Segment, topics: Topics | None = None) -> Iterator[list[RawMessage]]:
        """Yield the messages of one segment of this recording, in lists that follow each other in time.

        Errors are those of `raw_messages`.
        """
        selection = self._select(topics, None, None)
        blocks = merge(self._members[segment.order[0]].segment_pieces(segment, selection))
        return _decompressed_blocks(blocks, self._members, self.problem_log)

    def to_arrow(
        self,
        topic: str,
        fields: Sequence[str] | None = None,
        *,
        start: Time | None = None,
        end: Time | None = None,
    ) -> pa.Table:
        """Return the messages of one topic as an Arrow table, one row each, in the order of log time.

        Args:
            topic: its name.
            fields: dotted names, each with all that lies below it, such as "linear_acceleration.x"; None: all.
            start: earliest log time, inclusive.
            end: latest log time, exclusive.

        Returns:
            `log_time_ns` and `publish_time_ns` (int64, nanoseconds of the log clock), then a column a field, in the
            units of the message type. Without a schema that can be decoded: one column `data`.

        Raises:
            NoSuchTopic: there is none of that name.
            NoSuchField: a name that fits no column.
            ReadingExtraMissing: the extra `reading` is not installed.
            SourceError: the bytes cannot be read.
        """
        decoder, messages, notice = self._of_topic(topic, start, end)
        return decoding.to_arrow(decoder, messages, fields=fields, notice=notice)

    def to_pandas(
        self,
        topic: str,
        fields: Sequence[str] | None = None,
        *,
        start: Time | None = None,
        end: Time | None = None,
    ) -> pd.DataFrame:
        """Return what `to_arrow` returns, as a pandas frame with the log times (UTC, to the ns) as its index."""
        decoder, messages, notice = self._of_topic(topic, start, end)
        frame = decoding.to_pandas(decoder, messages, fields=fields, notice=notice)
        import pandas  # available, because `to_pandas` has used it

        frame.index = pandas.DatetimeIndex(
            pandas.to_datetime(frame["log_time_ns"], unit="ns", utc=True), name="log_time"
        )
        return frame

    def batches(
        self,
        topic: str,
        fields: Sequence[str] | None = None,
        *,
        start: Time | None = None,
        end: Time | None = None,
        batch_bytes: int = BATCH_BYTES,
    ) -> Iterator[pa.RecordBatch]:
        """Yield the rows of `to_arrow` in batches, for topics that are larger than the memory.

        `batch_bytes`: of the messages of one batch, at most; a larger message is a batch of its own.
        """
        decoder, messages, notice = self._of_topic(topic, start, end)
        return decoding.arrow_batches(decoder, messages, fields=fields, notice=notice, batch_bytes=batch_bytes)

    def to_mcap(
        self,
        path: str | PathLike[str],
        topics: Topics | None = None,
        *,
        start: Time | None = None,
        end: Time | None = None,
        options: McapOptions | None = None,
        sha256: Mapping[str, str] | None = None,
        on_progress: OnProgress | None = None,
    ) -> McapResult:
        """Write the recording, or a slice of it, as one whole MCAP: chunked, indexed, with every CRC, by log time.

        Topics, types, encodings, times and bytes of messages stay as they are; ROS 1 stays ROS 1. Channels without
        messages, attachments and metadata records are kept. Of a damaged recording, what can be read is written. A
        metadata record `kleinkram:made_from` says what the file was made from, and what was lost. The same recording
        gives the same bytes, whatever else is on the machine. Memory stays below about 200 MB.

        Of a slice, only the index and the chunks that may hold its messages are read. Messages of latched topics that
        were valid at its start come first, with the start as log time (`writing.latched`).

        Args:
            path: a file that does not exist yet. It appears when it is complete.
            topics: names or globs; None: all.
            start: earliest log time, inclusive, as in `raw_messages`.
            end: latest log time, exclusive.
            options: compression and chunks, and what is copied beside messages.
            sha256: of the files, by their names, for the metadata record; by default what their sources know.
            on_progress: called with the share that is done, from 0 to 1, every few MB.

        Raises:
            CannotWrite: the file exists, its folder cannot be written to or is full, or the recording is a ULog.
            NoSuchTopic: a name that is no glob is not among the topics.
            EmptyRange: the end is not after the start.
            OutsideRecording: nothing was recorded between start and end.
            TooDisordered: too many parts overlap in time to be put in order in bounded memory.
            SourceError: the bytes cannot be read, or a local file was written to while it was read.
            ValueError: a text is no time.
        """
        from kleinkram.recordings.writing.mcap import merge_to_mcap

        known = None if sha256 is None else [sha256]
        return merge_to_mcap(
            [self], path, topics, start=start, end=end, options=options, sha256=known, on_progress=on_progress
        )

    def to_parquet(
        self, folder: str | PathLike[str], topics: Topics | None = None, *, on_progress: OnProgress | None = None
    ) -> ParquetResult:
        """Write each topic as a Parquet file with the columns of `to_arrow`, in row groups of about 4 MB of messages.

        The file of `/camera/front` is `camera.front.parquet`. Its metadata are `topic`, `message_type`,
        `message_encoding`, `recording`, and `frame_id` where all messages have the same. Topics that cannot be decoded
        are left out, and named in the result.

        Args:
            folder: is made if it does not exist; files in it are not replaced. A file appears when it is complete.
            topics: names or globs; None: all.
            on_progress: called with the share of topics that is done.

        Raises:
            CannotWrite: a file exists, or the folder cannot be written to or is full.
            NoSuchTopic: a name that is no glob is not among the topics.
            ReadingExtraMissing: the extra `reading` is not installed.
            SourceError: the bytes cannot be read.
        """
        from kleinkram.recordings.writing.parquet import write_parquet

        return write_parquet(self, Path(folder), self.select_topics(topics), on_progress)

    def select_topics(self, topics: Topics | None = None) -> tuple[Topic, ...]:
        """Return the topics of these names or globs, by name; `NoSuchTopic` for a name that is not among them."""
        selected = self._select(topics, None, None).topics
        return tuple(topic for topic in self.topics if selected is None or topic.name in selected)

    def topic(self, name: str) -> Topic:
        """Return the topic of this name; `NoSuchTopic` if there is none."""
        for topic in self.topics:
            if topic.name == name:
                return topic
        raise NoSuchTopic(name, [topic.name for topic in self.topics])

    def close(self) -> None:
        """Close the files that were opened by path; a second call does nothing."""
        self._is_closed = True
        self._stack.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _of_topic(
        self, name: str, start: Time | None, end: Time | None
    ) -> tuple[Decoder | Undecodable, Iterator[tuple[int, int, bytes]], Callable[[int, DecodeError], None]]:
        """Return the decoder of a topic, its messages, and what reports a message that cannot be decoded."""
        topic = self.topic(name)
        blocks = self._blocks(Selection(frozenset((name,)), *resolve_range(start, end, self.start_ns, self.end_ns)))

        def notice(log_time_ns: int, error: DecodeError) -> None:
            message = f"at {log_time_ns} ns: {error}; what could not be decoded is null"
            self.problem_log.add("message-undecodable", name, message)

        messages = _timed(blocks, topic.schema, topic.message_encoding, self.problem_log)
        return decoder_of(topic.message_encoding, topic.schema), messages, notice

    def _select(self, topics: Topics | None, start: Time | None, end: Time | None) -> Selection:
        span = resolve_range(start, end, self.start_ns, self.end_ns)
        return Selection(select_names(topics, [topic.name for topic in self.topics]), *span)

    def _blocks(self, selection: Selection) -> Iterator[Block]:
        return merged_blocks([self], selection)

    def pieces(self, selection: Selection, number: int) -> Iterator[MessagePiece]:
        """Yield the parts that may hold selected messages, by first time; for modules of `kleinkram.recordings`.

        `number`: of this recording, among several that are merged.
        """
        parts = [member.pieces(selection, (number, order)) for order, member in enumerate(self._members)]
        return heapq.merge(*parts, key=lambda piece: piece.first_ns)


_DAMAGED = frozenset(("damaged", "damaged-message", "too-damaged", "too-late"))


def select_names(topics: Topics | None, names: Sequence[str]) -> frozenset[str] | None:
    """Return the names that `topics` (names or globs) selects; None for None, which selects all.

    Raises:
        NoSuchTopic: a name that is no glob is not among the names.
    """
    if topics is None:
        return None
    selected: set[str] = set()
    for pattern in [topics] if isinstance(topics, str) else topics:
        is_glob = pattern not in names and any(sign in pattern for sign in "*?[")
        if not is_glob and pattern not in names:
            raise NoSuchTopic(pattern, [*names])
        selected.update([name for name in names if fnmatchcase(name, pattern)] if is_glob else [pattern])
    return frozenset(selected)


def merged_blocks(recordings: Sequence[Recording], selection: Selection) -> Iterator[Block]:
    """Yield the messages of recordings by log time, as lists that follow each other; equal times in the order given.

    The memory is that of one recording, except for what `ChunkedMember.max_ahead` allows each of them.
    """
    pieces = [recording.pieces(selection, number) for number, recording in enumerate(recordings)]
    log = recordings[0].problem_log
    blocks = merge(heapq.merge(*pieces, key=lambda piece: piece.first_ns), log.note_late)
    members = [member for recording in recordings for member in recording.members]
    return _decompressed_blocks(blocks, members, log)


def _decompressed_blocks(
    blocks: Iterator[Block], members: Iterable[OpenedFile], problem_log: ProblemLog
) -> Iterator[Block]:
    """Decompress messages that are compressed one by one; leave out damaged ones, and report them."""
    channels = (channel for member in members for channel in member.contents.channels.values())
    if not any(channel.message_compression for channel in channels):
        return blocks

    def decompress(message: RawMessage) -> RawMessage | None:
        if not message.channel.message_compression:
            return message
        try:
            return message._replace(data=unpack_message(message.data, MAX_MESSAGE))
        except Malformed as error:
            problem_log.add("damaged-message", message.topic, f"left out: {error.message}")
            return None

    return ([one for one in map(decompress, block) if one is not None] for block in blocks)


def _decode_blocks(blocks: Iterable[Block], problem_log: ProblemLog) -> Iterator[Message]:
    """Yield decoded messages; one that cannot be decoded has its bytes as value."""
    decoders: dict[int, tuple[Channel, Decoder | None]] = {}
    new = tuple.__new__
    for block in blocks:
        for topic, log_ns, publish_ns, sequence, data, channel in block:
            known = decoders.get(id(channel))
            if known is None:
                decoder = decoder_of(channel.message_encoding, channel.schema)
                known = decoders[id(channel)] = (channel, decoder if isinstance(decoder, Decoder) else None)
            value: object = data
            if known[1] is not None:
                try:
                    value = known[1].decode(data)
                except DecodeError as error:
                    problem_log.add("message-undecodable", topic, f"a message stays bytes: {error}")
            yield new(Message, (topic, log_ns, publish_ns, sequence, value, channel))


def decode(message: RawMessage) -> object:
    """Return the value of a message, as `Recording.messages` does.

    Raises:
        DecodeError: it cannot be decoded.
    """
    decoder = decoder_of(message.channel.message_encoding, message.channel.schema)
    if isinstance(decoder, Undecodable):
        raise DecodeError(decoder.type_name, decoder.reason)
    return decoder.decode(message.data)


def decoder_of(message_encoding: str, schema: Schema) -> Decoder | Undecodable:
    """Return the decoder of the messages of a schema, or why there is none."""
    if (message_encoding, schema.encoding) == ("ulog", "ulog"):
        return decoding.decoder_for("ros1", schema.name, "ros1msg", as_ros1_definition(schema.name, schema.data))
    return decoding.decoder_for(message_encoding, schema.name, schema.encoding, schema.data)


def _timed(
    blocks: Iterable[Block], schema: Schema, encoding: str, problem_log: ProblemLog
) -> Iterator[tuple[int, int, bytes]]:
    """Yield log time, publish time and bytes of the messages of one layout; others are left out and reported."""
    fitting: dict[int, bool] = {}
    for block in blocks:
        for topic, log_ns, publish_ns, _sequence, data, channel in block:
            fits = fitting.get(id(channel))
            if fits is None:
                fits = fitting[id(channel)] = _have_one_layout(
                    channel.schema, schema, channel.message_encoding, encoding
                )
            if fits:
                yield log_ns, publish_ns, data
            else:
                message = f"messages of type {channel.schema.name} are left out of the table of {schema.name}"
                problem_log.add("topic-types-differ", topic, message)


def _have_one_layout(one: Schema, other: Schema, one_encoding: str, other_encoding: str) -> bool:
    if one_encoding != other_encoding or one.name != other.name:
        return False
    if one == other:
        return True
    decoders = [decoder_of(one_encoding, schema) for schema in (one, other)]
    layouts = [decoder.layout for decoder in decoders if isinstance(decoder, Decoder)]
    return len(layouts) == 2 and layouts[0] == layouts[1]


def _list_topics(contents: Iterable[MemberContents]) -> tuple[Topic, ...]:
    """Return the topics by name, with the counts over all files; None if one of them is unknown."""
    first: dict[str, Channel] = {}
    counts: dict[str, int | None] = {}
    for content in contents:
        for number, channel in content.channels.items():
            topic = channel.topic
            first.setdefault(topic, channel)
            so_far = counts.setdefault(topic, 0)
            here = None if content.counts is None else content.counts.get(number, 0)
            counts[topic] = None if so_far is None or here is None else so_far + here
    topics = []
    for name, channel in sorted(first.items()):
        decoder = decoder_of(channel.message_encoding, channel.schema)
        undecodable = decoder.reason if isinstance(decoder, Undecodable) else None
        schema = channel.schema
        topics.append(Topic(name, schema.name, schema, channel.message_encoding, counts[name], undecodable))
    return tuple(topics)
