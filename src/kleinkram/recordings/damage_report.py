"""Damage of a file: where it is, how much is lost, and the problems found while the file is read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import FREE_UNPACKED, MAX_DAMAGE, MAX_EXPANSION, MAX_PROBLEMS
from kleinkram.recordings.model import Content, Lost, Problem, RecordingSummary, counted

_FREE_WASTED_BYTES = 256 * 2**20
_WASTED_SHARE = 4


@dataclass
class DamageReport:
    """Data that a scan could not read.

    Attributes:
        damage: what is wrong, in file order; at most `MAX_DAMAGE`.
        messages: lost ones, as far as the indexes behind damaged chunks say; all of them if `messages_are_known`.
        unverified: messages saved from a chunk whose checksum is missing with its end.
        unpacked_bytes: that came out of compressed chunks.
        wasted_bytes: of records that were read, turned out to be invalid, and were searched for others.
    """

    damage: list[Malformed] = field(default_factory=list)
    index_faults: list[Malformed] = field(default_factory=list)
    bytes: int = 0
    chunks: int = 0
    messages: int = 0
    messages_are_known: bool = True
    unverified: int = 0
    wasted_bytes: int = 0
    unpacked_bytes: int = 0

    def unpack(self, uncompressed: int, *, end: int) -> None:
        """Count the uncompressed size of a chunk that ends at an offset of the file."""
        if not self.may_unpack(uncompressed, end=end):
            most = _max_unpacked(end)
            message = (
                f"not decompressed: with its {uncompressed} bytes, the file would expand to more than {most} (limit)"
            )
            raise Malformed("chunk", message, certain=False)

    def may_unpack(self, uncompressed: int, *, end: int) -> bool:
        """Count as `unpack` does and return True; return False, uncounted, above the limit."""
        if self.unpacked_bytes + uncompressed > _max_unpacked(end):
            return False
        self.unpacked_bytes += uncompressed
        return True

    def is_search_budget_spent(self, position: int) -> bool:
        """Return whether more bytes before `position` were searched without result than real damage explains.

        The search behind an invalid chunk begins inside it, so a file of chunk heads would be read once for each head.
        """
        return self.wasted_bytes > _FREE_WASTED_BYTES + _WASTED_SHARE * position

    def skip_chunk(self, start: int, size_bytes: int, messages: int, why: Malformed) -> None:
        """Count a chunk that cannot be read, and the messages that its index lists."""
        self.note(Malformed(f"chunk at byte {start}", why.message, certain=why.certain))
        self.chunks += 1
        self.bytes += size_bytes
        self.messages += messages

    def note(self, damage: Malformed) -> None:
        """Add a damaged location."""
        if len(self.damage) < MAX_DAMAGE:
            self.damage.append(_alone(damage))

    def note_index(self, fault: Malformed) -> None:
        """Add a fault of the index."""
        if len(self.index_faults) < MAX_DAMAGE:
            self.index_faults.append(_alone(fault))

    def problems(self) -> list[Problem]:
        """Return damage and index faults as problems, up to one more than a summary lists."""
        listed = [Problem("damaged", fault.where, fault.message) for fault in self.damage[: MAX_PROBLEMS + 1]]
        return listed + [
            Problem("index-damaged", fault.where, fault.message) for fault in self.index_faults[: MAX_PROBLEMS + 1]
        ]

    def describe(
        self, summary: RecordingSummary, *, claimed: int | None, reasons: Sequence[str] = (), checksum_note: str = ""
    ) -> RecordingSummary:
        """Return the summary of a damaged file with its content, its loss, and the reason, which begins with `reasons`.

        `claimed`: as of `total`. `checksum_note`: follows the number of messages that were read without a checksum.
        """
        messages, parts = summary.message_count or 0, [*reasons]
        content = Content.recovered
        if not (messages or summary.attachments or summary.metadata_records):
            is_broken = not self.damage or any(fault.certain for fault in self.damage)
            content = Content.broken if is_broken else Content.opaque
        if self.damage:
            first, others = self.damage[0], len(self.damage) - 1
            location = f"at {first.where}" if first.where.startswith("byte ") else f"in the {first.where}"
            more = f" (and {counted(others, 'more damaged location')})" if others else ""
            parts.append(f"it is damaged {location}: {first.message}{more}")
        if self.unverified:
            saved = counted(self.unverified, "message was", "messages were")
            parts.append(f"{saved} saved from the beginning of a cut chunk{checksum_note}")
        lost = self.total(claimed=claimed, readable=messages)
        parts.append(describe_readable(messages, lost))
        return replace(summary, content=content, reason="; ".join(parts), lost=lost)

    def total(self, *, claimed: int | None, readable: int) -> Lost:
        """Return the loss, which may be zero. `claimed`: messages that the file should hold; None: unknown."""
        messages = self.messages if self.messages_are_known else None
        if claimed is not None and claimed >= readable:
            messages = claimed - readable
        return Lost(self.bytes, self.chunks, messages)


def describe_readable(messages: int, lost: Lost | None) -> str:
    """Describe what can be read of a damaged file, and what is lost."""
    readable = f"{counted(messages, 'message')} can be read"
    if lost is None:
        return readable
    if lost == Lost(0, 0, 0):
        return f"{readable}; nothing is lost"
    if lost == Lost(0, 0, None):
        return f"{readable}; whether more was recorded is unknown"
    parts = [f"{lost.bytes} bytes"]
    if lost.chunks:
        parts.insert(0, counted(lost.chunks, "chunk"))
    parts.append("an unknown number of messages" if lost.messages is None else counted(lost.messages, "message"))
    return f"{readable}; lost: {', '.join(parts)}"


def _max_unpacked(end: int) -> int:
    return FREE_UNPACKED + MAX_EXPANSION * end


def _alone(fault: Malformed) -> Malformed:
    """Return a copy without traceback: its frames would keep their buffers alive."""
    return Malformed(fault.where, fault.message, certain=fault.certain)


@dataclass
class IndexedChunk:
    """The messages that the index records after a chunk list, and those that were readable."""

    start: int
    readable: int
    damaged: bool
    records: int = 0
    messages: int = 0

    def compare(self, losses: DamageReport) -> None:
        """Compare both, after all index records of the chunk."""
        if not self.damaged:
            if self.records and self.messages != self.readable:
                message = f"its index lists {counted(self.messages, 'message')}, it holds {self.readable}"
                losses.note_index(Malformed(f"chunk at byte {self.start}", message))
        elif self.records:
            losses.messages += max(0, self.messages - self.readable)
        else:
            losses.messages_are_known = False


class ProblemLog:
    """The problems of one recording: each once, up to `MAX_PROBLEMS`."""

    def __init__(self) -> None:
        self._problems: dict[tuple[str, str], Problem] = {}
        self._left_out = 0
        self._late_count = 0

    def add(self, code: str, where: str, message: str) -> None:
        """Add a problem, unless there is one with this code and location."""
        if (code, where) in self._problems:
            return
        if len(self._problems) < MAX_PROBLEMS:
            self._problems[code, where] = Problem(code, where, message)
        else:
            self._left_out += 1

    def note_late(self, messages: int) -> None:
        """Set how many messages one iteration has left out so far because they came too late to be in order."""
        self._late_count = max(self._late_count, messages)

    def all(self, known: Iterable[Problem] = ()) -> tuple[Problem, ...]:
        """Return the `known` problems from elsewhere, then those of this log in their order."""
        merged: dict[tuple[str, str], Problem] = {}
        for problem in (*known, *self._problems.values()):
            merged.setdefault((problem.code, problem.where), problem)
        problems = list(merged.values())
        if self._late_count:
            late = counted(self._late_count, "message is", "messages are")
            message = f"{late} left out: earlier than the index says, too late to be put in order"
            problems.append(Problem("too-late", "messages", message))
        if self._left_out:
            message = f"{self._left_out} more problems are not listed"
            problems.append(Problem("more-problems", "file", message))
        return tuple(problems)
