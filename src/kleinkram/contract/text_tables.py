r"""Tables as CSV, Markdown and LaTeX, the same from the server, the SDK and the command line.

All text is escaped for its format. Markdown is that of GitHub (GFM, section 4.10); LaTeX needs the package `booktabs`.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from kleinkram.contract.actions import Better
from kleinkram.contract.metrics import DEFAULT_DIGITS, Aggregate, MetricTableRead, Missing, Rank, TextFormat

TableValue = str | int | float | None
MISSING_TEXTS = {
    Missing.no_run: "no run",
    Missing.running: "running",
    Missing.failed: "failed",
    Missing.cancelled: "cancelled",
    Missing.no_metric: "no metric",
}
NO_GROUP = "(none)"
BETTER_TEXTS = {Better.lower: "lower is better", Better.higher: "higher is better"}
DIFFERENCE = "difference"
# Whole numbers of a double are exact below.
_WHOLE_BELOW = 2**53
# Exponents of ten between which numbers are written without one.
_MIN_EXPONENT, _MAX_EXPONENT = -5, 15
_SPACE = re.compile(r"\s+")
# Source: LaTeX2e reference manual, section 2.1; `[` and `*` after `\\`, and `--`, have a meaning of their own.
_LATEX = {
    **{character: f"\\{character}" for character in "#$%&_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    # By their codes: their names are not known in every font encoding.
    "`": r"\symbol{96}",
    '"': r"\symbol{34}",
    "[": "{[}",
    "*": "{*}",
    "-": "{-}",
}
# Source: CommonMark 0.31, section 2.4: characters that mean something within a line; `$` is GitHub's mathematics.
_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>|#~&$])")
# Source: OWASP, "CSV Injection".
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class TextTable:
    """A table to write. The first column holds texts, the others numbers, or the reason why there is none.

    Attributes:
        title: what the numbers are, with their unit; empty where the headers say it.
        best: row and column of each value to be set in bold, counted from 0.
        totals: rows below a rule.
        notes: sentences below the table.
    """

    headers: Sequence[str]
    rows: Sequence[Sequence[TableValue]]
    title: str = ""
    best: frozenset[tuple[int, int]] = frozenset()
    totals: Sequence[Sequence[TableValue]] = ()
    notes: Sequence[str] = field(default_factory=list)


def write_table(table: TextTable, text_format: TextFormat, digits: int = DEFAULT_DIGITS) -> str:
    """Return a table as text that ends with a line feed.

    CSV has all digits, and empty cells where there is no number; the others have so many significant digits.
    """
    if text_format is TextFormat.csv:
        return _csv(table)
    return _markdown(table, digits) if text_format is TextFormat.markdown else _latex(table, digits)


def significant(value: float, digits: int = DEFAULT_DIGITS) -> str:
    """Return a number with so many significant digits, trailing zeros included; without exponent where it can be."""
    if isinstance(value, int) or value == 0:
        return str(int(value))
    exponent = int(f"{value:.{digits - 1}e}".rpartition("e")[2])
    if _MIN_EXPONENT <= exponent < _MAX_EXPONENT:
        return f"{value:.{max(0, digits - 1 - exponent)}f}"
    return f"{value:.{digits - 1}e}"


def metric_text_table(table: MetricTableRead) -> TextTable:
    """Return a table of metrics to write; a comparison adds the column `difference`, and a note."""
    numbers = [cell.value for row in table.rows for cell in row.cells if cell.value is not None]
    convert = int if all(value.is_integer() and abs(value) < _WHOLE_BELOW for value in numbers) else float
    rows: list[list[TableValue]] = []
    for row in table.rows:
        cells: list[TableValue] = [NO_GROUP if row.label is None else row.label]
        for cell in row.cells:
            reason = MISSING_TEXTS.get(cell.missing or Missing.no_run)
            cells.append(reason if cell.value is None else convert(cell.value))
        rows.append(cells)
    headers = [table.row_group.removeprefix("metadata."), *(column.label for column in table.columns)]
    notes = []
    if table.comparison is not None:
        headers.append(DIFFERENCE)
        for cells, difference in zip(rows, table.comparison.differences, strict=True):
            cells.append(None if difference is None else convert(difference))
        notes.append(comparison_text(table))
    if table.varying:
        notes.append(f"Results of one column differ in {', '.join(table.varying)}.")
    best = frozenset(
        (at, column + 1)
        for at, row in enumerate(table.rows)
        for column, cell in enumerate(row.cells)
        if cell.rank is Rank.best
    )
    return TextTable(headers, rows, title=metric_title(table), best=best, notes=notes)


def metric_title(table: MetricTableRead) -> str:
    """Return what the numbers of a table are: `ate_rmse [m], median, lower is better`."""
    name = table.metric if table.aggregate is not Aggregate.count else f"number of {table.metric}"
    unit = f" [{table.unit}]" if table.unit else ""
    aggregate = [] if table.aggregate is Aggregate.count else [table.aggregate.value]
    better = [BETTER_TEXTS[table.better]] if table.better in BETTER_TEXTS else []
    return ", ".join([f"{name}{unit}", *aggregate, *better])


def comparison_text(table: MetricTableRead) -> str:
    """Return a comparison as a sentence; empty where there is none."""
    compared = table.comparison
    if compared is None:
        return ""
    first, second = table.columns[compared.first].label, table.columns[compared.second].label
    if compared.median_difference is None or compared.mean_difference is None:
        return f"{second} against {first}: no row has both."
    unit = f" {table.unit}" if table.unit else ""
    middle = (significant(value) for value in (compared.median_difference, compared.mean_difference))
    parts = [
        f"{compared.pair_count} {'pair' if compared.pair_count == 1 else 'pairs'}",
        *(f"{name} difference {value}{unit}" for name, value in zip(("median", "mean"), middle, strict=True)),
    ]
    if compared.wins is not None and compared.losses is not None:
        counts = ((compared.wins, "win", "wins"), (compared.losses, "loss", "losses"), (compared.ties, "tie", "ties"))
        parts += [f"{number} {one if number == 1 else many}" for number, one, many in counts]
    return f"{second} against {first}: {', '.join(parts)}."


def _csv(table: TextTable) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(csv_text, table.headers))
    for first, *others in [*table.rows, *table.totals]:
        label = csv_text(first) if isinstance(first, str) else first
        writer.writerow([label, *("" if isinstance(value, str) else value for value in others)])
    return text.getvalue()


def csv_text(text: str) -> str:
    """Return a text for a cell of CSV: what a spreadsheet would take for a formula is marked as text."""
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text


def _markdown(table: TextTable, digits: int) -> str:
    lines = [f"**{_markdown_text(table.title)}**", ""] if table.title else []
    alignment = ["---", *("---:" for _ in table.headers[1:])]
    lines += [_markdown_row([_markdown_text(header) for header in table.headers]), _markdown_row(alignment)]
    cells = _formatted(table, digits, lambda text, _: _markdown_text(text), "**{}**".format)
    lines += map(_markdown_row, cells)
    lines += [text for note in table.notes for text in ("", _markdown_text(note))]
    return "\n".join(lines) + "\n"


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _markdown_text(text: str) -> str:
    return _MARKDOWN.sub(r"\\\1", _one_line(text))


def _latex(table: TextTable, digits: int) -> str:
    count = len(table.headers)
    lines = ["% Requires \\usepackage{booktabs}.", f"\\begin{{tabular}}{{l{'r' * (count - 1)}}}", "  \\toprule"]
    if table.title and count > 1:
        heading = f"\\multicolumn{{{count - 1}}}{{c}}{{{_latex_text(table.title)}}}"
        lines += [f"   & {heading} \\\\", f"  \\cmidrule(lr){{2-{count}}}"]
    lines += [_latex_row([_latex_text(header) for header in table.headers]), "  \\midrule"]
    cells = [_latex_row(row) for row in _formatted(table, digits, _latex_cell, _latex_bold)]
    lines += cells[: len(table.rows)]
    if table.totals:
        lines += ["  \\midrule", *cells[len(table.rows) :]]
    lines += ["  \\bottomrule", "\\end{tabular}", *(f"% {_one_line(note)}" for note in table.notes)]
    return "\n".join(lines) + "\n"


def _latex_row(cells: Sequence[str]) -> str:
    return f"  {' & '.join(cells)} \\\\"


def _latex_bold(text: str) -> str:
    # Mathematics has bold letters of its own.
    return f"$\\mathbf{{{text[1:-1]}}}$" if text.startswith("$") else f"\\textbf{{{text}}}"


def _latex_cell(text: str, is_number: bool) -> str:
    if not is_number:
        return _latex_text(text)
    mantissa, _, exponent = text.partition("e")
    if exponent:
        return f"${mantissa} \\times 10^{{{int(exponent)}}}$"
    return f"${text}$" if text.startswith("-") else text


def _latex_text(text: str) -> str:
    escaped = "".join(_LATEX.get(character, character) for character in _one_line(text))
    # Single hyphens stay readable; several would become a dash.
    return re.sub(r"(?<!\{-\})\{-\}(?!\{-\})", "-", escaped)


def _formatted(
    table: TextTable, digits: int, write: Callable[[str, bool], str], embolden: Callable[[str], str]
) -> list[list[str]]:
    """Return the texts of all rows, then of the totals; `write` gets a text, and whether it is a number."""
    formatted = []
    for at, row in enumerate([*table.rows, *table.totals]):
        cells = []
        for column, value in enumerate(row):
            is_number = not isinstance(value, str) and value is not None and math.isfinite(value)
            text = "" if value is None else value if isinstance(value, str) else significant(value, digits)
            cell = write(text, is_number)
            cells.append(embolden(cell) if (at, column) in table.best else cell)
        formatted.append(cells)
    return formatted


def _one_line(text: str) -> str:
    """Return a text without line breaks and other control characters, which would end a row or a comment."""
    return _SPACE.sub(" ", "".join(character if character.isprintable() else " " for character in text)).strip()
