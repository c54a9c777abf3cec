"""What of a recording could not be read, measured by a scan of its files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from kleinkram.recordings.chunk_reader import ChunkedMember
from kleinkram.recordings.chunk_table import ChunkTable
from kleinkram.recordings.formats.base import OpenedFile
from kleinkram.recordings.model import Problem, RecordingSummary

if TYPE_CHECKING:
    from kleinkram.recordings.recording import Recording

_BYTE = re.compile(r"byte (\d+)")


@dataclass(frozen=True)
class LostPlace:
    """A damaged part. `where`: such as "chunk at byte 4117"; its messages were between the two log times, if known."""

    where: str
    reason: str
    after_ns: int | None = None
    before_ns: int | None = None


@dataclass(frozen=True)
class MemberLoss:
    """What is lost of one file of a recording.

    Attributes:
        file: its name.
        reason: a sentence: what is wrong, what can be read, what is lost.
        bytes: that belong to nothing readable.
        chunks: of which nothing or not everything could be read.
        messages: how many are lost; None if unknown.
        places: at most about fifty.
    """

    file: str
    reason: str
    bytes: int
    chunks: int
    messages: int | None
    places: tuple[LostPlace, ...]


def find_losses(recording: Recording, other_places: Iterable[LostPlace] = ()) -> tuple[MemberLoss, ...]:
    """Return what is lost of each file, after all messages were read. A file is scanned only if something was damaged.

    `other_places`: damaged attachments and metadata records.
    """
    summaries = recording.scan_files() if recording.is_damaged else ()
    return _losses(recording, summaries, other_places)


def losses_met(recording: Recording, other_places: Iterable[LostPlace] = ()) -> tuple[MemberLoss, ...]:
    """Return the damage that was met while a slice was read. Reads nothing: the rest of the files may be damaged, too.

    What is known of a file that was scanned to be opened concerns all of it.
    """
    return _losses(recording, [member.summary for member in recording.members], other_places)


def _losses(
    recording: Recording, summaries: Iterable[RecordingSummary | None], other_places: Iterable[LostPlace]
) -> tuple[MemberLoss, ...]:
    files = zip(recording.files, recording.members, summaries)  # noqa: B905  # no summaries: nothing is damaged
    losses = [loss for file, member, summary in files if summary and (loss := _loss_of(file, member, summary))]
    unnamed = [problem for problem in recording.damage if not losses or problem.code != "damaged"]
    others = tuple(other_places)
    places = (*(LostPlace(problem.where, problem.message) for problem in unnamed), *others)
    if places:
        reason = f"{places[0].where}: {places[0].reason}"
        name = recording.files[0] if len(recording.files) == 1 else PurePosixPath(recording.name).name
        losses.append(MemberLoss(name, reason, 0, 0, None if unnamed else 0, places))
    return tuple(losses)


def _loss_of(file: str, member: OpenedFile, summary: RecordingSummary) -> MemberLoss | None:
    if summary.lost is None:
        return None
    table = member.table if isinstance(member, ChunkedMember) else ChunkTable()
    places = tuple(_places(summary.problems, table))
    lost = summary.lost
    return MemberLoss(file, summary.reason or "it is damaged", lost.bytes, lost.chunks, lost.messages, places)


def _places(problems: Iterable[Problem], table: ChunkTable) -> Iterator[LostPlace]:
    for problem in problems:
        if problem.code == "damaged":
            match = _BYTE.search(problem.where)
            span = (None, None) if match is None else _span_around(table, int(match[1]))
            yield LostPlace(problem.where, problem.message, *span)


def _span_around(table: ChunkTable, position: int) -> tuple[int | None, int | None]:
    """Return the log times between which messages at a position of the file were, by the chunks around it."""
    after_ns = before_ns = None
    for row in table.rows:
        if row.start == position:
            return row.first_ns, row.last_ns
        if row.start > position:
            before_ns = row.first_ns
            break
        after_ns = row.last_ns
    return after_ns, before_ns
