"""Tables (CSV): columns, their names, rows. One pass, nothing kept."""

from __future__ import annotations

import csv

from kleinkram.recordings.forward import Forward
from kleinkram.recordings.model import Content, Fact, RecordingFormat, RecordingSummary
from kleinkram.recordings.other.lines import read_lines

_MOST_NAMES = 64
_MAX_NAME = 128


def describe_table(forward: Forward) -> RecordingSummary:
    """Read a whole table. Its first line is a header if no cell of it is a number.

    Raises:
        SourceError: as `Forward.read`.
    """
    names: list[str] = []
    columns = rows = 0
    for line in read_lines(forward):
        if not line.strip():
            continue
        if columns == 0:
            # The names of EuRoC's tables stand behind a comment sign.
            cells = _cells(line.lstrip(b"#"))
            columns = len(cells)
            if line.startswith(b"#") or not any(map(_is_number, cells)):
                names = cells
                continue
        rows += not line.startswith(b"#")
    facts = [Fact("columns", columns), Fact("rows", rows)]
    facts += [Fact("column", name[:_MAX_NAME]) for name in names[:_MOST_NAMES] if name]
    return RecordingSummary(RecordingFormat.csv, Content.opaque, "a table (CSV), not a recording", facts=tuple(facts))


def _cells(line: bytes) -> list[str]:
    try:
        found = next(csv.reader([line.decode("utf-8", "replace")]), [])
    except csv.Error:
        found = line.decode("utf-8", "replace").split(",")
    return [cell.strip() for cell in found]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
