"""Messages of an MCAP that stand outside of chunks: counted in batches, so that a file of nothing else is fast."""

from __future__ import annotations

from kleinkram.recordings.listening import RECORDS, Place
from kleinkram.recordings.mcap import chunks
from kleinkram.recordings.mcap.records import McapFacts
from kleinkram.recordings.mcap.walking import walk_messages
from kleinkram.recordings.stream import Lookahead
from kleinkram.recordings.tally import Batch, Tally

_FLUSH_BYTES = 8 * 2**20


class LooseMessages:
    """Takes messages at the next byte of a stream; `flush` at the end, so that all are counted."""

    def __init__(self, stream: Lookahead, facts: McapFacts, tally: Tally) -> None:
        self._stream = stream
        self._facts = facts
        self._tally = tally
        self._batch = Batch(facts.channels)
        self._bytes = 0

    def walk(self) -> int:
        """Take all messages in the window, and pass over all but the last; return how many bytes that one has.

        0: none stands here that is at hand as a whole.
        """
        stream = self._stream
        after, last = walk_messages(stream.window, stream.at, len(stream.window), self._batch)
        self._tell(after - stream.at)
        self._pass(last - stream.at)
        return after - last

    def take_large(self, total: int) -> None:
        """Take one message of `total` bytes, of which only the head is at hand; passes over nothing.

        Raises:
            Malformed: it is too short to be one.
        """
        channel_id, row = chunks.read_large_message(self._stream)
        self._batch[channel_id].extend(row)
        self._tell(total)
        self._pass(0)

    def flush(self) -> None:
        """Count what was taken."""
        self._tally.learn(self._facts.channels)
        self._tally.add(self._batch)
        self._batch, self._bytes = Batch(self._facts.channels), 0

    def _pass(self, length: int) -> None:
        self._stream.advance(length)
        self._bytes += length
        if self._bytes > _FLUSH_BYTES:
            self.flush()

    def _tell(self, length: int) -> None:
        """Tell the listener of the messages that stand in the next bytes, as many as are given."""
        if self._facts.listener is not None and length:
            chunks.tell(self._facts, Place(RECORDS, self._stream.position, length, length), self._batch)
            self.flush()  # what the batch holds next stands somewhere else
