"""What is said of a command that is not there by what should start it: Docker's tini, Podman's catatonit, a shell.

Imports nothing but Python's own library, since wardens wait for it.
"""

import itertools
import re
from collections.abc import Iterable

from kleinkram.runner.docker import gate
from kleinkram.runner.docker.log import Piece

# Of tini and shells 126 and 127, of catatonit 1.
CODES = (1, 126, 127)
_CODES_OF_SHELL = (126, 127)
# It is the first and the last that such a container says.
_PIECES = 4
_TINI = re.compile(r"\[FATAL tini[^\]]*\] exec (.+) failed: (.+)")
_CATATONIT = re.compile(r"ERROR \(catatonit:\d+\): failed to exec \S+: (.+)")
# Of dash, bash and busybox.
_SHELL = re.compile(rf"^{gate.NAME}: (?:exec: )?(?:line )?\d+: (?:exec: )?(.+): ([^:\n]+)$", re.MULTILINE)


def no_command(written: Iterable[list[Piece]], command: list[str] | None, exit_code: int) -> str | None:
    """Return what keeps a command from running, by what its container wrote; None where nothing did.

    `command` is what the container was given, of which catatonit does not tell.
    """
    pieces = itertools.islice((piece for pieces in written for piece in pieces), _PIECES)
    text = b"".join(piece.data for piece in pieces).decode(errors="replace")
    if said := _TINI.search(text) or (_SHELL.search(text) if exit_code in _CODES_OF_SHELL else None):
        return f"{said[1]}: {said[2]}"
    if said := _CATATONIT.search(text):
        return f"{command[0]}: {said[1]}" if command else said[1]
    return None
