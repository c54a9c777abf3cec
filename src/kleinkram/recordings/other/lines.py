"""Lines of a text of any size, read forward: one block and one line are held, and a line that is too long is cut."""

from __future__ import annotations

from collections.abc import Iterator

from kleinkram.recordings.forward import Forward
from kleinkram.recordings.limits import WINDOW

MAX_LINE_BYTES = 64 * 2**10


def read_lines(forward: Forward) -> Iterator[bytes]:
    """Yield lines without their end, empty ones too; of a longer line than `MAX_LINE_BYTES` only its beginning.

    Raises:
        SourceError: as `Forward.read`.
    """
    rest = b""
    is_cut = False
    while block := forward.read(WINDOW):
        *lines, last = block.split(b"\n")
        for line in lines:
            if not is_cut:
                yield (rest + line)[:MAX_LINE_BYTES].rstrip(b"\r")
            rest, is_cut = b"", False
        rest += last
        if len(rest) > MAX_LINE_BYTES and not is_cut:
            yield rest[:MAX_LINE_BYTES]
            is_cut = True
        rest = b"" if is_cut else rest
    if rest and not is_cut:
        yield rest.rstrip(b"\r")
