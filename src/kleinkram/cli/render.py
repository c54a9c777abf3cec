"""How things look on a terminal: tables, details, JSON. Data on stdout, all else on stderr.

Names come from strangers: whatever a terminal could obey is escaped before it is printed.
"""

import datetime
import json
import os
import shutil
import sys
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

import typer
from pydantic import BaseModel

_GAP = 2
_LEAST = 12
_wide: list[bool] = []  # not empty after `show_wide`
_OBEYED = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def escape(text: str) -> str:
    """Return text without control and direction characters, each shown as its code."""
    return "".join(_escaped(character) if _is_obeyed(character) else character for character in text)


def _is_obeyed(character: str) -> bool:
    return unicodedata.category(character) in _OBEYED


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode() if ord(character) > 0x7F else f"\\x{ord(character):02x}"


def note(text: str) -> None:
    """Print a line to stderr, escaped: who writes it need not think of what a name in it may hold."""
    typer.echo(escape(text), err=True)


def line(text: str) -> None:
    """Print a line of data to stdout, escaped likewise."""
    typer.echo(escape(text))


def show_json(value: BaseModel | Mapping[str, object]) -> None:
    """Print one JSON document to stdout."""
    json.dump(plain(value), sys.stdout, indent=2)
    sys.stdout.write("\n")


def show_json_list(rows: Iterable[BaseModel]) -> None:
    """Print `{"items": [...]}` to stdout."""
    show_json({"items": [*rows]})


def plain(value: object) -> object:
    """Return models, wherever they stand, as what JSON takes."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value


def show_wide() -> None:
    """Show ids in tables, and every column in full, from now on."""
    _wide.append(True)


def table(headers: Sequence[str], rows: Iterable[Sequence[object]], *, to_stderr: bool = False) -> None:
    """Print aligned columns; numbers to the right.

    On a terminal, long texts are cut and columns at the right left out, so that each row is one line. Where other
    programs read, nothing is cut. The column `id` is there only with `--wide`.
    """
    shown = [column for column, header in enumerate(headers) if header != "id" or _wide]
    headers = [headers[column] for column in shown]
    cells = [[_cell(row[column]) for column in shown] for row in map(tuple, rows)]
    if not cells:
        note("Nothing found.")
        return
    widths = [max(_width(row[column]) for row in [headers, *cells]) for column in range(len(headers))]
    right = [all(_is_number(row[column]) for row in cells) for column in range(len(headers))]
    widths = _fitted(widths, right)
    for row in [[header.upper() for header in headers], *cells]:
        padded = [_pad(_cut(cell, width), width, at_right) for cell, width, at_right in zip(row, widths, right)]  # noqa: B905  columns at the right may be left out
        typer.echo("  ".join(padded).rstrip(), err=to_stderr)
    if len(widths) < len(headers):
        note(f"Not shown for lack of room: {', '.join(headers[len(widths) :])}. --wide shows all.")


def _columns() -> int | None:
    """Return how many columns the terminal has; None where no person looks."""
    columns_text = os.environ.get("COLUMNS", "")
    if _wide or not (sys.stdout.isatty() or columns_text.isdigit()):
        return None
    return shutil.get_terminal_size().columns


def _fitted(widths: list[int], right: Sequence[bool]) -> list[int]:
    """Return widths with which a row fits the terminal: long texts get less, then columns at the right are left out."""
    room = _columns()
    if room is None:
        return widths
    fitted = [*widths]
    while sum(fitted) + _GAP * (len(fitted) - 1) > room:
        texts = [column for column, width in enumerate(fitted) if width > _LEAST and not right[column]]
        if texts:
            widest = max(texts, key=lambda column: fitted[column])
            fitted[widest] -= 1
        elif len(fitted) > 1:
            fitted = [*widths[: len(fitted) - 1]]
        else:
            break
    return fitted


def _cut(text: str, width: int) -> str:
    """Return a text of at most this width; what is left out of the middle is an ellipsis."""
    if _width(text) <= width:
        return text
    head, tail = text[: (width - 1) // 3], text
    while _width(head) + 1 + _width(tail) > width:
        tail = tail[1:]
    return f"{head}…{tail}"


def details(pairs: Iterable[tuple[str, object]]) -> None:
    """Print one thing's properties, a line each; those without a value are left out."""
    columns_text = [(name, _cell(value)) for name, value in pairs if value not in (None, "", [])]
    width = max((len(name) for name, _ in columns_text), default=0)
    for name, value in columns_text:
        line(f"{name + ':':<{width + 1}} {value}")


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, datetime.datetime):
        return moment(value)
    if isinstance(value, list | tuple):
        return escape(", ".join(str(one) for one in value))
    return escape(str(value))


def moment(at: datetime.datetime) -> str:
    """Return a time in UTC, to the second."""
    return at.astimezone(datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def _width(text: str) -> int:
    return sum(
        0 if unicodedata.combining(character) else 2 if unicodedata.east_asian_width(character) in "WF" else 1
        for character in text
    )


def _pad(text: str, width: int, at_right: bool) -> str:
    space = " " * (width - _width(text))
    return space + text if at_right else text + space


def _is_number(text: str) -> bool:
    return text == "-" or text[:1].isdigit() or text[:1] == "-"
