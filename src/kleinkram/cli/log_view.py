"""What a run writes, as a terminal may see it: its colours, and nothing else that a terminal obeys."""

import re
import sys
from typing import TextIO

from kleinkram.cli.render import escape

# Source: ECMA-48, section 8.3.117, SGR: colours and weights of letters.
_COLOUR = re.compile(r"(\x1b\[[0-9;]*m)")
_PLAIN = "\x1b[0m"


def harmless(text: str) -> str:
    """Return text of which a terminal obeys line feeds, tabs and colours alone; each line ends in plain letters.

    A bar that draws itself over and over, each time after a carriage return, is its last state.
    """
    return "\n".join(_line(line) for line in text.split("\n"))


def _line(line: str) -> str:
    last = line.rstrip("\r").rpartition("\r")[2]
    parts = _COLOUR.split(last)
    shown = "".join(part if at % 2 else _escaped(part) for at, part in enumerate(parts))
    return shown + _PLAIN if len(parts) > 1 else shown


def _escaped(text: str) -> str:
    return "\t".join(escape(entry) for entry in text.split("\t"))


def write_log(text: str, stream: TextIO) -> None:
    """Write what a run wrote: to a terminal harmlessly, to a file or pipe as it is."""
    stream.write(harmless(text) if stream.isatty() else text)
    stream.flush()


def on_stderr(data: bytes) -> None:
    """Write what a run on this machine wrote."""
    write_log(data.decode(errors="replace"), sys.stderr)
