"""Where an MCAP goes on behind damage.

A whole MCAP may stand inside of this one, in an attachment or as a message. Where the length around it is damaged, the
search comes upon its records, which look like any other. They are not this file's: what stands between a magic, or a
header that is not the first record, and the end of that inner file is passed over. An inner file without an end takes
all that follows with it: too little is counted rather than what was never recorded.
"""

from __future__ import annotations

import re
from collections.abc import Container

from kleinkram.recordings.decompress import Buffer
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.losses import Losses
from kleinkram.recordings.mcap.plausible import LOOK, find_record
from kleinkram.recordings.mcap.records import FOOTER_BYTES, HEADER, MAGIC
from kleinkram.recordings.stream import Lookahead

_SEARCH_BYTES = 4 * 2**20
_END = rb"\x02\x14\0{7}.{20}" + re.escape(MAGIC)
"""A footer, and the magic behind it."""
_MARK = re.compile(_END + b"|" + re.escape(MAGIC), re.DOTALL)


def pass_damage(stream: Lookahead, channels: Container[int], losses: Losses) -> None:
    """Pass over at least one byte, up to the next place where a record of this file stands."""
    start = 0 if stream.window[stream.at] == HEADER and stream.position != len(MAGIC) else 1
    while stream.left:
        width = _bring(stream)
        at, end = stream.at, stream.at + width
        found = find_record(stream.window, at + start, end, stream.left - start, channels)
        inner = find_inner(stream.window, at, end if found is None else found, stream.left)
        if inner is None and found is not None and stream.window[found] == HEADER:
            inner = found
        start = 0
        if inner is not None:
            stream.advance(inner - at)
            _pass_inner(stream, losses)
            continue
        stream.advance(width if found is None else found - at)
        if found is not None:
            return


def find_inner(data: Buffer, start: int, end: int, left: int) -> int | None:
    """Return the first place in [start, end) where another MCAP begins; `left`: bytes from `start` to the end of the
    file, whose last magic is its own.
    """
    for match in _MARK.finditer(data, start, min(len(data), end + FOOTER_BYTES)):
        if match.start() >= end:
            return None
        if _opens(match) and match.end() - start < left:
            return match.start()
    return None


def _bring(stream: Lookahead) -> int:
    """Bring bytes into the window; return how many of them a record or magic may begin in that is there as a whole."""
    at_hand = stream.ahead(_SEARCH_BYTES)
    return at_hand if at_hand == stream.left else at_hand - LOOK


def _opens(match: re.Match[bytes]) -> bool:
    return match.end() - match.start() == len(MAGIC)


def _pass_inner(stream: Lookahead, losses: Losses) -> None:
    """Pass over another file, which begins here, and over those in it."""
    message = "another MCAP begins inside of this one; what stands in it is not counted"
    losses.note(Malformed(f"byte {stream.position}", message))
    depth = 1
    stream.advance(1)
    while stream.left and depth:
        width = _bring(stream)
        end = min(len(stream.window), stream.at + width + FOOTER_BYTES)
        match = _MARK.search(stream.window, stream.at, end)
        if match is None or match.start() >= stream.at + width:
            stream.advance(width)
            continue
        depth += 1 if _opens(match) else -1
        stream.advance(match.end() - stream.at)
