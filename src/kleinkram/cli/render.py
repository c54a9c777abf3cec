"""The output of commands: tables, details and JSON on stdout, notes on stderr, all escaped."""

import datetime
import json
import os
import shutil
import sys
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import typer
from pydantic import BaseModel

RowT = TypeVar("RowT", bound=BaseModel)
_GAP = 2
_MIN_WIDTH = 12
_wide: list[bool] = []  # not empty after `show_wide`
_UNPRINTABLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def escape(text: str) -> str:
    """Return text without control and direction characters, each shown as its code."""
    return "".join(
        character
        if unicodedata.category(character) not in _UNPRINTABLE
        else character.encode("unicode_escape").decode()
        if ord(character) > 0x7F
        else f"\\x{ord(character):02x}"
        for character in text
    )


def note(text: str) -> None:
    """Print a line to stderr, escaped."""
    typer.echo(escape(text), err=True)


def line(text: str) -> None:
    """Print a line of data to stdout, escaped."""
    typer.echo(escape(text))


def show_json(value: BaseModel | Mapping[str, object]) -> None:
    """Print one JSON document to stdout."""
    json.dump(plain(value), sys.stdout, indent=2)
    sys.stdout.write("\n")


def plain(value: object) -> object:
    """Return a value for JSON: models, also nested ones, become dicts."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


@dataclass(frozen=True)
class Output:
    """What a command prints: with `--json` the document, else the text.

    `text` is a note or several, for stderr, or a function that prints. The command then ends with the exit code.
    """

    document: BaseModel | Mapping[str, object]
    text: str | Sequence[str] | Callable[[], object] = ()
    exit_code: int = 0

    def show(self, as_json: bool) -> None:
        """Print it, and end the command if the exit code is not 0."""
        if as_json:
            show_json(self.document)
        elif callable(self.text):
            self.text()
        else:
            for text in [self.text] if isinstance(self.text, str) else self.text:
                note(text)
        if self.exit_code:
            raise typer.Exit(self.exit_code)


def as_total(number: int) -> Output:
    """Return the number of rows that match, for `--count`."""
    return Output({"total": number}, lambda: line(str(number)))


def as_list(rows: Iterable[RowT], show: Callable[[Sequence[RowT]], object]) -> Output:
    """Return rows, which a function prints."""
    items = [*rows]
    return Output({"items": items}, lambda: show(items))


def as_table(rows: Iterable[RowT], headers: Sequence[str], cells: Callable[[RowT], Sequence[object]]) -> Output:
    """Return rows, whose cells are printed as a table."""
    return as_list(rows, lambda items: table(headers, map(cells, items)))


def as_details(value: BaseModel | Mapping[str, object], pairs: Iterable[tuple[str, object]]) -> Output:
    """Return one thing, whose properties are printed a line each."""
    return Output(value, lambda: details(pairs))


def show_wide() -> None:
    """Show ids in tables, and every column in full, from now on."""
    _wide.append(True)


def table(headers: Sequence[str], rows: Iterable[Sequence[object]], *, to_stderr: bool = False) -> None:
    """Print aligned columns; numbers to the right.

    On a terminal, long texts are cut and columns at the right left out, so that each row is one line. In a pipe
    nothing is cut. The column `id` is shown only with `--wide`.
    """
    shown = [column for column, header in enumerate(headers) if header != "id" or _wide]
    headers = [headers[column] for column in shown]
    cells = [[_cell(row[column]) for column in shown] for row in map(tuple, rows)]
    if not cells:
        note("Nothing found.")
        return
    widths = [max(_width(row[column]) for row in [headers, *cells]) for column in range(len(headers))]
    right = [all(text[:1].isdigit() or text[:1] == "-" for text in column) for column in zip(*cells, strict=True)]
    widths = _fitted(widths, right)
    for row in [[header.upper() for header in headers], *cells]:
        padded = []
        for cell, width, at_right in zip(row, widths, right):  # noqa: B905  columns at the right may be left out
            text = _cut(cell, width)
            space = " " * (width - _width(text))
            padded.append(space + text if at_right else text + space)
        typer.echo("  ".join(padded).rstrip(), err=to_stderr)
    if len(widths) < len(headers):
        note(f"Not shown, because the terminal is too narrow: {', '.join(headers[len(widths) :])}. --wide shows all.")


def _fitted(widths: list[int], right: Sequence[bool]) -> list[int]:
    """Return widths with which a row fits the terminal: long texts get less, then columns at the right are left out."""
    if _wide or not (sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()):
        return widths
    room = shutil.get_terminal_size().columns
    fitted = [*widths]
    while sum(fitted) + _GAP * (len(fitted) - 1) > room:
        texts = [column for column, width in enumerate(fitted) if width > _MIN_WIDTH and not right[column]]
        if texts:
            widest = max(texts, key=lambda column: fitted[column])
            fitted[widest] -= 1
        elif len(fitted) > 1:
            fitted = [*widths[: len(fitted) - 1]]
        else:
            break
    return fitted


def _cut(text: str, width: int) -> str:
    """Return a text of at most this width, with an ellipsis for the middle."""
    if _width(text) <= width:
        return text
    head, tail = text[: (width - 1) // 3], text
    while _width(head) + 1 + _width(tail) > width:
        tail = tail[1:]
    return f"{head}…{tail}"


def details(pairs: Iterable[tuple[str, object]]) -> None:
    """Print the properties of one thing, a line each; those without a value are left out."""
    shown = [(name, _cell(value)) for name, value in pairs if value not in (None, "", [])]
    width = max((len(name) for name, _ in shown), default=0)
    for name, value in shown:
        line(f"{name + ':':<{width + 1}} {value}")


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, datetime.datetime):
        return moment(value)
    if isinstance(value, list | tuple):
        return escape(", ".join(map(str, value)))
    return escape(str(value))


def moment(at: datetime.datetime) -> str:
    """Return a time in UTC, to the second."""
    return at.astimezone(datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def _width(text: str) -> int:
    return sum(
        0 if unicodedata.combining(character) else 2 if unicodedata.east_asian_width(character) in "WF" else 1
        for character in text
    )
