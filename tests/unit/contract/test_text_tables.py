"""Tables as CSV, Markdown and LaTeX: numbers, escapes, and what a table of metrics becomes."""

import csv
import io
import re
import uuid

import pytest

from kleinkram.contract.actions import Better
from kleinkram.contract.metrics import (
    Aggregate,
    MetricCell,
    MetricColumn,
    MetricComparison,
    MetricRow,
    MetricTableQuery,
    MetricTableRead,
    Missing,
    Rank,
    TextFormat,
)
from kleinkram.contract.text_tables import (
    TextTable,
    comparison_text,
    metric_text_table,
    metric_title,
    significant,
    write_table,
)

_HOSTILE = '\\ & % $ # _ { } ~ ^ < > | ` " [x] * a--b \n\x00\u2028é'


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0, 4, "0"),
        (7, 4, "7"),
        (0.012345, 4, "0.01235"),
        (0.0123, 4, "0.01230"),
        (12345.678, 4, "12346"),
        (9.99999, 4, "10.00"),
        (-0.5, 2, "-0.50"),
        (0.00001, 2, "0.000010"),
        (0.000001, 2, "1.0e-06"),
        (1e15, 3, "1.00e+15"),
        (0.1 + 0.2, 17, "0.30000000000000004"),
    ],
)
def test_numbers_have_significant_digits_and_rarely_an_exponent(value: float, digits: int, text: str) -> None:
    assert significant(value, digits) == text


def _table(**changes: object) -> TextTable:
    values = {"headers": ["mission", "a_b@1"], "rows": [[_HOSTILE, 0.5]], "title": "ate [m]"}
    return TextTable(**{**values, **changes})  # type: ignore[arg-type]  # a test's own values


def test_latex_is_escaped_and_has_the_rules_of_booktabs() -> None:
    text = write_table(
        _table(best=frozenset({(0, 1)}), totals=[["total", -3]], notes=["50 %\n\\end"]), TextFormat.latex
    )
    assert text.splitlines() == [
        "% Requires \\usepackage{booktabs}.",
        "\\begin{tabular}{lr}",
        "  \\toprule",
        "   & \\multicolumn{1}{c}{ate {[}m]} \\\\",
        "  \\cmidrule(lr){2-2}",
        "  mission & a\\_b@1 \\\\",
        "  \\midrule",
        "  \\textbackslash{} \\& \\% \\$ \\# \\_ \\{ \\} \\textasciitilde{} \\textasciicircum{} \\textless{}"
        " \\textgreater{} \\textbar{} \\symbol{96} \\symbol{34} {[}x] {*} a{-}{-}b é & \\textbf{0.5000} \\\\",
        "  \\midrule",
        "  total & $-3$ \\\\",
        "  \\bottomrule",
        "\\end{tabular}",
        "% 50 % \\end",
    ]


def test_exponents_and_signs_are_mathematics_in_latex() -> None:
    rows = [["a", -1.5e-7], ["b", 2e20], ["c", -2.0]]
    text = write_table(_table(rows=rows, best=frozenset({(0, 1)})), TextFormat.latex, digits=2)
    assert "a & $\\mathbf{-1.5 \\times 10^{-7}}$ \\\\" in text
    assert "b & $2.0 \\times 10^{20}$ \\\\" in text
    assert "c & $-2.0$ \\\\" in text


def test_latex_of_a_table_without_columns_is_still_one() -> None:
    text = write_table(_table(headers=["mission"], rows=[["a"]]), TextFormat.latex)
    assert "\\begin{tabular}{l}\n  \\toprule\n  mission \\\\\n  \\midrule\n  a \\\\\n" in text


def test_markdown_is_escaped() -> None:
    lines = write_table(_table(best=frozenset({(0, 1)})), TextFormat.markdown).splitlines()
    assert lines[:2] == ["**ate \\[m\\]**", ""]
    assert lines[2:4] == ["| mission | a\\_b@1 |", "| --- | ---: |"]
    cells = re.split(r"(?<!\\)\|", lines[4])
    assert len(cells) == 4, "a bar in a name does not end a cell"
    assert cells[1].strip() == '\\\\ \\& % \\$ \\# \\_ \\{ \\} \\~ ^ \\< \\> \\| \\` " \\[x\\] \\* a--b é'
    assert cells[2].strip() == "**0.5000**"


def test_csv_has_all_digits_and_no_reasons() -> None:
    table = _table(rows=[["a, b", 0.1 + 0.2], ["c", "failed"], ["d", None]], notes=["a note"])
    rows = [*csv.reader(io.StringIO(write_table(table, TextFormat.csv)))]
    assert rows == [["mission", "a_b@1"], ["a, b", "0.30000000000000004"], ["c", ""], ["d", ""]]


def _metrics(*rows: list[MetricCell], **changes: object) -> MetricTableRead:
    values: dict[str, object] = {
        "metric": "ate",
        "unit": "m",
        "better": Better.lower,
        "description": "",
        "aggregate": Aggregate.median,
        "row_group": "metadata.robot",
        "column_dimensions": ["version"],
        "columns": [MetricColumn(label=f"version {number}", values={"version": number}) for number in (1, 2)],
        "rows": [MetricRow(label=None if at == 0 else f"r{at}", cells=cells) for at, cells in enumerate(rows)],
        "dimensions": [],
        "varying": [],
    }
    return MetricTableRead.model_validate(values | changes)


def _value(value: float, rank: Rank | None = None) -> MetricCell:
    return MetricCell(value=value, count=1, run_count=1, run_ids=[uuid.uuid4()], rank=rank)


def test_a_table_of_metrics_names_missing_cells_and_marks_the_best() -> None:
    failed = MetricCell(missing=Missing.failed)
    table = _metrics([_value(1, Rank.worst), _value(0.5, Rank.best)], [_value(2), failed], varying=["param.x"])
    written = metric_text_table(table)
    assert written.headers == ["robot", "version 1", "version 2"]
    assert written.rows == [["(none)", 1.0, 0.5], ["r1", 2.0, "failed"]]
    assert (written.best, written.notes) == (frozenset({(0, 2)}), ["Results of one column differ in param.x."])
    assert written.title == "ate [m], median, lower is better"
    counts = _metrics([_value(1), _value(2)], aggregate=Aggregate.count, unit=None, better=Better.none)
    assert (metric_title(counts), metric_text_table(counts).rows) == ("number of ate", [["(none)", 1, 2]])
    assert isinstance(metric_text_table(counts).rows[0][1], int)


def test_a_comparison_is_a_column_and_a_sentence() -> None:
    compared = MetricComparison(
        first=0,
        second=1,
        differences=[-0.5, None],
        pair_count=1,
        median_difference=-0.5,
        mean_difference=-0.5,
        wins=1,
        losses=0,
        ties=0,
    )
    cells = [[_value(1), _value(0.5)], [_value(1), MetricCell(missing=Missing.no_run)]]
    table = _metrics(*cells, comparison=compared)
    written = metric_text_table(table)
    assert (written.headers[-1], [row[-1] for row in written.rows]) == ("difference", [-0.5, None])
    assert comparison_text(table) == (
        "version 2 against version 1: 1 pair, median difference -0.5000 m, mean difference -0.5000 m,"
        " 1 win, 0 losses, 0 ties."
    )
    none = compared.model_copy(update={"median_difference": None, "mean_difference": None, "pair_count": 0})
    assert comparison_text(_metrics(comparison=none)) == "version 2 against version 1: no row has both."
    assert comparison_text(_metrics()) == ""


@pytest.mark.parametrize(
    "query",
    [
        {"rows": "robot"},
        {"rows": "metadata."},
        {"columns": []},
        {"columns": ["param"]},
        {"columns": ["action", "action"]},
        {"compare": ["a"]},
        {"metric": "ATE RMSE"},
        {"digits": 0},
    ],
)
def test_invalid_tables_are_refused(query: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(query))):
        MetricTableQuery.model_validate({"metric": "ate"} | query)


def test_csv_has_no_formulas() -> None:
    rows = [["=HYPERLINK(1)", -1.5], ["+1", 1.0], ["-a", 1.0], ["@a", 1.0], ["a=b", 1.0]]
    text = write_table(_table(headers=["mission", "=1"], rows=rows), TextFormat.csv)
    first, *others = [*csv.reader(io.StringIO(text))]
    assert first == ["mission", "'=1"]
    assert [row[0] for row in others] == ["'=HYPERLINK(1)", "'+1", "'-a", "'@a", "a=b"]
    assert others[0][1] == "-1.5", "numbers stay numbers"
