"""What is left of a damaged rosbag2 database, as a member: its whole messages, in a temporary file of records.

The records are those of an unchunked MCAP, so that order and bounds are those of any other file.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

from kleinkram.recordings.chunk_reader import MAX_MESSAGE
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import Malformed, SourceError
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.chunks import MESSAGE_FIELDS, table_of_records
from kleinkram.recordings.formats.mcap.format import MCAP_CHUNKS
from kleinkram.recordings.formats.rosbag2.recovery import Recovery
from kleinkram.recordings.member import ChunkedMember, MemberContents
from kleinkram.recordings.messages import Channel, Schema
from kleinkram.recordings.model import counted
from kleinkram.recordings.sources import FileSource
from kleinkram.recordings.streams import open_range
from kleinkram.recordings.temporary_files import TooLarge, temporary_copy

_LATEST_NS = 2**63 - 1


def open_recovered(
    path: Path, name: str, problem_log: ProblemLog, stack: ExitStack, *, message_compression: str = ""
) -> ChunkedMember:
    """Open what is left of a database; the temporary file goes with the stack.

    Raises:
        SourceError: it cannot be read, or there is no room for the temporary file.
    """
    counts: dict[int, int] = defaultdict(int)
    channels: dict[int, Channel] = {}
    try:
        with Recovery(path, name) as recovery:
            numbers = {topic.topic_id: number for number, topic in enumerate(recovery.result.topics)}
            channels = {
                number: Channel(
                    topic.name,
                    topic.serialization_format or "cdr",
                    Schema(topic.message_type, "", b""),
                    message_compression,
                )
                for number, topic in enumerate(recovery.result.topics)
            }
            copy = stack.enter_context(temporary_copy(_reading(_records(recovery, numbers, counts))))
            result = recovery.result
            lost = counted(result.lost_messages, "message is", "messages are")
            message = f"{result.first_damage or 'it is damaged'}; at least {lost} lost"
            problem_log.add("damaged", f"{name}: pages", message)
    except Malformed as error:
        problem_log.add("damaged", f"{name}: pages", f"nothing of it can be read: {error}")
        copy = stack.enter_context(temporary_copy(lambda _: b""))
    except TooLarge as error:
        raise SourceError(f"{name}: {error}") from error
    source = stack.enter_context(FileSource(copy))
    table = table_of_records(open_range(source, 0, source.size_bytes))
    contents = MemberContents(channels, counts, sum(counts.values()), *table.span())
    return ChunkedMember(source, MCAP_CHUNKS, table, contents, problem_log)


def _records(recovery: Recovery, numbers: dict[int, int], counts: dict[int, int]) -> Iterator[bytes]:
    """Yield each message as a record; those of topics that nothing defines are left out."""
    for row, data in recovery.messages_with_data(MAX_MESSAGE):
        number = numbers.get(row.topic_id)
        if number is None or not 0 <= row.timestamp <= _LATEST_NS:
            continue
        counts[number] += 1
        head = MESSAGE_FIELDS.pack(number, 0, row.timestamp, row.timestamp)
        yield records.RECORD_HEAD.pack(records.MESSAGE, len(head) + len(data)) + head + data


def _reading(pieces: Iterator[bytes]) -> Callable[[int], bytes]:
    """Return a function that returns the next piece, whatever its size; b"" at the end."""
    return lambda _most: next(pieces, b"")
