"""Chunks of a bag that are too large to be held: decompressed in small steps, their messages counted as they come."""

from __future__ import annotations

from kleinkram.recordings.bag import contents, records
from kleinkram.recordings.bag.contents import BagFacts, parse_record, walk
from kleinkram.recordings.bag.walking import learn_layout
from kleinkram.recordings.decompress import open_decompressed
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_TAKE, WINDOW
from kleinkram.recordings.listening import Place
from kleinkram.recordings.stream import Decompressed, Lookahead
from kleinkram.recordings.tally import Batch, Tally

_FLUSH_BYTES = 64 * 2**20


def read_large_chunk(
    outer: Lookahead, compression: str, stored: int, facts: BagFacts, tally: Tally, place: Place
) -> None:
    """Add the messages of a chunk that is too large to be held, from where its data begin.

    `stored`: bytes of its data. `place`: of the chunk, for the listener.

    Raises:
        Malformed: it is damaged, or ends with the file.
    """
    uncompressed, left = place.uncompressed, stored

    def read(most: int) -> bytes:
        nonlocal left
        piece = outer.read_up_to(min(most, left))
        left -= len(piece)
        return piece

    inner = Lookahead(Decompressed(open_decompressed(compression, read, uncompressed), uncompressed), with_crc=False)
    batch = Batch(facts.connections)
    flushed = 0
    try:
        while inner.left:
            inner.ahead(WINDOW)
            walked = walk(inner.window, inner.at, len(inner.window), facts, batch)[0] - inner.at
            inner.advance(walked if walked else _pass_record(inner, facts, batch))
            if inner.position - flushed > _FLUSH_BYTES:
                flushed = inner.position
                _tell(facts, place, batch)
                tally.add(batch, stored=stored, uncompressed=uncompressed)
                batch = Batch(facts.connections)
    finally:
        tally.learn(facts.connections)
        _tell(facts, place, batch)
        tally.add(batch, stored=stored, uncompressed=uncompressed)


def _tell(facts: BagFacts, place: Place, batch: Batch) -> None:
    if facts.listener is not None:
        facts.listener.hear(place, batch)


def _pass_record(inner: Lookahead, facts: BagFacts, batch: Batch) -> int:
    """Read a record in a large chunk; return its size."""
    where = f"byte {inner.position} of its contents"
    record = parse_record(inner.window, inner.at, where)
    total = record.end - record.start
    if total > inner.left:
        raise Malformed(where, "a record reaches beyond the end")
    if record.opcode == records.MESSAGE:
        contents.add_message(record, batch)
        if facts.layout is None:
            facts.layout = learn_layout(inner.window, inner.at)
    elif record.opcode == records.CONNECTION:
        inner.ahead(min(total, MAX_TAKE))
        data_at = inner.at + record.data_start - record.start
        data = bytes(inner.window[data_at : data_at + record.data_bytes])
        contents.define(record, data, facts, where)
    return total
