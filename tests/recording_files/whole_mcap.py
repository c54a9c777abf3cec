"""An MCAP as the `mcap` package reads it, after everything in it was checked."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from mcap import records
from mcap.reader import SeekingReader
from mcap.stream_reader import StreamReader

from kleinkram.recordings import Content, FileSource, scan
from kleinkram.recordings.sources import SourceReader
from tests.recording_files import mcap_doctor

IndependentMessage = tuple[str, int, int, int, bytes]
"""Topic, log time, publish time, sequence, data."""


@dataclass(frozen=True)
class WholeMcap:
    """What is in the file."""

    header: records.Header
    channels: list[records.Channel]
    schemas: dict[int, records.Schema]
    messages: list[IndependentMessage]
    attachments: list[records.Attachment]
    metadata: list[records.Metadata]
    compressions: set[str]

    def metadata_of(self, name: str) -> dict[str, str]:
        """Return the entries of the last metadata record of a name."""
        return [record.metadata for record in self.metadata if record.name == name][-1]


def read_whole_mcap(path: Path) -> WholeMcap:
    """Read a file with all checksums, by its records and by its index; assert that both agree.

    The rules are those of `mcap doctor`: definitions before messages, chunks and indexes that are true, statistics that
    count, messages in the order of log time.
    """
    mcap_doctor.examine(path)
    with path.open("rb") as stream:
        all_records = list(StreamReader(stream, validate_crcs=True, emit_chunks=False).records)
    header = all_records[0]
    assert isinstance(header, records.Header)
    assert header.library
    end = next(number for number, record in enumerate(all_records) if isinstance(record, records.DataEnd))
    data_section, summary = all_records[:end], all_records[end + 1 :]
    channels: dict[int, records.Channel] = {}
    schemas: dict[int, records.Schema] = {}
    messages: list[IndependentMessage] = []
    for record in data_section:
        if isinstance(record, records.Schema):
            assert record.id
            assert record.id not in schemas
            assert record.encoding or not record.data
            schemas[record.id] = record
        elif isinstance(record, records.Channel):
            assert record.id not in channels
            assert record.schema_id == 0 or record.schema_id in schemas
            channels[record.id] = record
        elif isinstance(record, records.Message):
            topic = channels[record.channel_id].topic
            messages.append((topic, record.log_time, record.publish_time, record.sequence, record.data))
    assert {r.id: r for r in summary if isinstance(r, records.Channel)} == channels
    assert {r.id: r for r in summary if isinstance(r, records.Schema)} == schemas
    stamps = [message[1] for message in messages]
    assert stamps == sorted(stamps)
    whole = _with_index(path, WholeMcap(header, [*channels.values()], schemas, messages, [], [], set()))
    _compare_statistics(whole, summary, Counter(r.channel_id for r in data_section if isinstance(r, records.Message)))
    return whole


def _with_index(path: Path, by_records: WholeMcap) -> WholeMcap:
    with path.open("rb") as stream:
        reader = SeekingReader(stream, validate_crcs=True)
        by_index = [
            (channel.topic, message.log_time, message.publish_time, message.sequence, message.data)
            for _schema, channel, message in reader.iter_messages()
        ]
        summary = reader.get_summary()
        assert summary is not None
        attachments, metadata = [*reader.iter_attachments()], [*reader.iter_metadata()]
        assert len(attachments) == len(summary.attachment_indexes)
        assert len(metadata) == len(summary.metadata_indexes)
        compressions = {chunk.compression for chunk in summary.chunk_indexes}
    assert by_index == by_records.messages
    with FileSource(path) as source:
        ours = scan(SourceReader(source))
    assert (ours.content, ours.lost, ours.message_count) == (Content.indexed, None, len(by_index))
    assert not {problem.code for problem in ours.problems} & {"index-damaged", "counts-disagree", "damaged"}
    return WholeMcap(
        by_records.header,
        by_records.channels,
        by_records.schemas,
        by_records.messages,
        attachments,
        metadata,
        compressions,
    )


def _compare_statistics(whole: WholeMcap, summary: list[records.McapRecord], counts: Counter[int]) -> None:
    (statistics,) = (record for record in summary if isinstance(record, records.Statistics))
    assert statistics.message_count == len(whole.messages)
    assert {number: count for number, count in statistics.channel_message_counts.items() if count} == counts
    assert (statistics.channel_count, statistics.schema_count) == (len(whole.channels), len(whole.schemas))
    assert (statistics.attachment_count, statistics.metadata_count) == (len(whole.attachments), len(whole.metadata))
    assert statistics.chunk_count == sum(isinstance(record, records.ChunkIndex) for record in summary)
    if whole.messages:
        span = whole.messages[0][1], whole.messages[-1][1]
        assert (statistics.message_start_time, statistics.message_end_time) == span
