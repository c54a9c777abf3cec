"""How things look on a terminal: tables, details, JSON. Data on stdout, all else on stderr.

Names come from strangers: whatever a terminal could obey is escaped before it is printed.
"""

import datetime
import json
import sys
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

import typer
from pydantic import BaseModel

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


def table(headers: Sequence[str], rows: Iterable[Sequence[object]], *, to_stderr: bool = False) -> None:
    """Print aligned columns; numbers to the right. Nothing is cut: other programs read this too."""
    cells = [[_cell(value) for value in row] for row in rows]
    if not cells:
        note("Nothing found.")
        return
    widths = [max(_width(row[column]) for row in [[*headers], *cells]) for column in range(len(headers))]
    right = [all(_is_number(row[column]) for row in cells) for column in range(len(headers))]
    for row in [[header.upper() for header in headers], *cells]:
        padded = [_pad(cell, width, at_right) for cell, width, at_right in zip(row, widths, right, strict=True)]
        typer.echo("  ".join(padded).rstrip(), err=to_stderr)


def details(pairs: Iterable[tuple[str, object]]) -> None:
    """Print one thing's properties, a line each; those without a value are left out."""
    said = [(name, _cell(value)) for name, value in pairs if value not in (None, "", [])]
    width = max((len(name) for name, _ in said), default=0)
    for name, value in said:
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
