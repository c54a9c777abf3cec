"""Message density: a histogram of the messages of a topic over time, with a bounded number of bins.

The width of a bin is a power of two of nanoseconds; a bin begins at a multiple of its width. The width is the smallest
with which all messages fit into the allowed number of bins. So it follows from the first and the last stamp alone, and
histograms add up exactly: those of chunks, files, recordings and missions equal the histogram of all their messages.
"""

from __future__ import annotations

import struct
import sys
from array import array
from bisect import bisect_left
from collections.abc import Iterable, Sequence

from kleinkram.recordings.model import MessageDensity

MAX_BINS = 256  # bins of one topic: between half as many and as many are in use, where messages lie far enough apart
MANY_TOPICS = 4096  # topics of a file, above which each has fewer bins
BINS_OF_MANY_TOPICS = 64

_HEAD = struct.Struct("<BBQ")
_CODES = "BHIQ"
_LARGEST = [2 ** (8 * array(code).itemsize) - 1 for code in _CODES]


def bins_per_topic(topic_count: int) -> int:
    """Return the maximum number of bins of each topic."""
    return MAX_BINS if topic_count <= MANY_TOPICS else BINS_OF_MANY_TOPICS


def count_stamps(stamps: Sequence[int], *, min_bin_ns: int = 1, max_bins: int = MAX_BINS) -> MessageDensity:
    """Return the density of sorted stamps, at least one, with bins of at least `min_bin_ns`."""
    bits = _bits(stamps[0], stamps[-1], min_bin_ns.bit_length() - 1, max_bins)
    first = stamps[0] >> bits
    bins = (stamps[-1] >> bits) - first + 1
    if bins == 1:
        return MessageDensity(first << bits, 1 << bits, (len(stamps),))
    counts = [0] * bins
    if len(stamps) < 4 * bins:
        for stamp in stamps:
            counts[(stamp >> bits) - first] += 1
    else:
        begin = 0
        for number in range(bins):
            end = bisect_left(stamps, (first + number + 1) << bits, begin)
            counts[number] = end - begin
            begin = end
    return MessageDensity(first << bits, 1 << bits, tuple(counts))


def add_up(densities: Iterable[MessageDensity], *, max_bins: int = MAX_BINS) -> MessageDensity | None:
    """Return the sum of densities; None if there are none."""
    parts = list(densities)
    if len(parts) == 1 and len(parts[0].counts) <= max_bins:
        return parts[0]
    if not parts:
        return None
    start_ns = min(part.start_ns for part in parts)
    last_ns = max(_last_ns(part) for part in parts)
    bits = _bits(start_ns, last_ns, max(part.bin_ns for part in parts).bit_length() - 1, max_bins)
    first = start_ns >> bits
    counts = [0] * ((last_ns >> bits) - first + 1)
    # The first part is often the longest: copied instead of added, if its bins have the same width.
    head = parts.pop(0) if parts[0].bin_ns == 1 << bits else None
    if head is not None:
        begin = (head.start_ns >> bits) - first
        counts[begin : begin + len(head.counts)] = head.counts
    for part in parts:
        _add(counts, part, first, bits)
    return MessageDensity(first << bits, 1 << bits, tuple(counts))


def on_axis(density: MessageDensity, *, start_ns: int, bin_ns: int, bins: int) -> list[int]:
    """Return the counts in bins of `bin_ns`, a power of two not below the density's; `start_ns`: a multiple of it."""
    bits = bin_ns.bit_length() - 1
    begin, end = density.start_ns >> bits, _last_ns(density) >> bits
    counts = [0] * (end - begin + 1)
    _add(counts, density, begin, bits)
    first = start_ns >> bits
    inside = counts[max(0, first - begin) : max(0, first + bins - begin)]
    before = [0] * min(bins, max(0, begin - first))
    return [*before, *inside, *([0] * (bins - len(before) - len(inside)))]


def pack(density: MessageDensity) -> bytes:
    """Return a density in few bytes: its width and first bin, then counts of 1, 2, 4 or 8 bytes, little-endian."""
    largest = max(density.counts)
    size = next(number for number, maximum in enumerate(_LARGEST) if largest <= maximum)
    bits = density.bin_ns.bit_length() - 1
    return _HEAD.pack(bits, size, density.start_ns >> bits) + _little(array(_CODES[size], density.counts)).tobytes()


def unpack(packed: bytes) -> MessageDensity:
    """Return what `pack` was given."""
    bits, size, first = _HEAD.unpack_from(packed)
    counts = array(_CODES[size])
    counts.frombytes(packed[_HEAD.size :])
    return MessageDensity(first << bits, 1 << bits, tuple(_little(counts)))


def _little(counts: array[int]) -> array[int]:
    if sys.byteorder == "big":
        counts.byteswap()
    return counts


def _last_ns(density: MessageDensity) -> int:
    return density.start_ns + len(density.counts) * density.bin_ns - 1


def _bits(first_ns: int, last_ns: int, bits: int, max_bins: int) -> int:
    """Return the smallest width, as a power of two from `bits` on, at which a span has at most `max_bins`."""
    # The smallest width that can be enough; at most two steps follow.
    bits = max(bits, ((last_ns - first_ns) // max_bins).bit_length() - 1)
    while (last_ns >> bits) - (first_ns >> bits) >= max_bins:
        bits += 1
    return bits


def _add(counts: list[int], part: MessageDensity, first: int, bits: int) -> None:
    """Add a density, of the same or a smaller width, to counts of bins from `first` on."""
    own_bits = part.bin_ns.bit_length() - 1
    own_first = part.start_ns >> own_bits
    shift = bits - own_bits
    if shift == 0:
        begin = own_first - first
        end = begin + len(part.counts)
        counts[begin:end] = map(int.__add__, counts[begin:end], part.counts)
        return
    step = 1 << shift
    at, number = 0, (own_first >> shift) - first
    upto = step - own_first % step
    while at < len(part.counts):
        counts[number] += sum(part.counts[at:upto])
        at, upto, number = upto, upto + step, number + 1
