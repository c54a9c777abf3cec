"""`klein metrics`, `klein stats` as tables for papers, and `client.metrics`, against a scripted server."""

import json
import sys
import uuid
from urllib.parse import parse_qs, urlsplit

import pytest
from typer.testing import CliRunner, Result

from kleinkram.cli.main import app
from kleinkram.client import Client, Endpoint, EndpointSource
from kleinkram.client.errors import InvalidInput, ReadingMissing
from kleinkram.contract.actions import Better
from kleinkram.contract.base import Page
from kleinkram.contract.metrics import (
    Aggregate,
    MetricCell,
    MetricColumn,
    MetricComparison,
    MetricName,
    MetricNames,
    MetricRow,
    MetricTableRead,
    Missing,
    Rank,
)
from kleinkram.contract.search import StatsRead, StatsRow
from tests.api_objects import mission_read
from tests.scripted_server import Scripted, scripted

MISSION = mission_read("day")
_HOURS = 3600 * 10**9


@pytest.fixture(autouse=True)
def _known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KLEINKRAM_TOKEN", "t")


def klein(script: Scripted, *arguments: object) -> Result:
    return CliRunner(env={"KLEINKRAM_URL": script.url}).invoke(app, [*map(str, arguments)])


def client_of(script: Scripted) -> Client:
    return Client(Endpoint("x", script.url, "t", EndpointSource.argument))


def _query(script: Scripted, number: int = -1) -> dict[str, list[str]]:
    return parse_qs(urlsplit(script.requests[number].path).query)


def _value(value: float, rank: Rank | None = None) -> MetricCell:
    return MetricCell(value=value, count=1, run_count=1, run_ids=[uuid.uuid4()], rank=rank)


def _table(*rows: MetricRow, comparison: MetricComparison | None = None) -> MetricTableRead:
    return MetricTableRead(
        metric="ate_rmse",
        unit="m",
        better=Better.lower,
        description="",
        aggregate=Aggregate.median,
        row_group="mission",
        column_dimensions=["action", "version"],
        columns=[MetricColumn(label=f"slam@{number}", values={"version": number}) for number in (1, 2)],
        rows=[*rows],
        dimensions=[],
        varying=["param.method"],
        comparison=comparison,
    )


_ROWS = (
    MetricRow(label="day", cells=[_value(0.1 + 0.2, Rank.worst), _value(0.012345, Rank.best)]),
    MetricRow(label="n_1", cells=[_value(1), MetricCell(missing=Missing.failed)]),
)
_COMPARED = MetricComparison(
    first=0,
    second=1,
    differences=[-0.287655, None],
    pair_count=1,
    median_difference=-0.287655,
    mean_difference=-0.287655,
    wins=1,
    losses=0,
    ties=0,
)


def test_a_table_is_printed_with_marks_reasons_and_the_comparison() -> None:
    with scripted(_table(*_ROWS, comparison=_COMPARED)) as script:
        ran = klein(script, "metrics", "table", "--metric", "ate_rmse", "--compare", "slam@1", "slam@2")
    assert ran.exit_code == 0, ran
    assert ran.stdout.splitlines() == [
        "ate_rmse [m], median, lower is better (* best of its row)",
        "MISSION   SLAM@1  SLAM@2    DIFFERENCE",
        "day      0.3000   0.01235*     -0.2877",
        "n_1       1.000   failed             -",
        "slam@2 against slam@1: 1 pair, median difference -0.2877 m, mean difference -0.2877 m,"
        " 1 win, 0 losses, 0 ties.",
        "Results of one column differ in param.method.",
    ]
    assert _query(script)["compare"] == ["slam@1", "slam@2"]


def test_options_become_the_query_of_the_table() -> None:
    options = ("--rows", "robot", "--columns", "version, param.method", "--aggregate", "count", "--better", "higher")
    filters = ("--action", "slam@2", "--query", "alps", "-w", "label.kind=se3", "-w", "robot=x", "--topic", "/a")
    with scripted(Page(items=[MISSION]), _table()) as script:
        ran = klein(script, "metrics", "table", "--metric", "ate", "-m", "day", *options, *filters, "--all-rows")
    assert ran.exit_code == 0, ran
    assert "No run that you can see reported ate_rmse" in ran.stderr
    assert _query(script) == {
        "metric": ["ate"],
        "mission_id": [str(MISSION.id)],
        "rows": ["metadata.robot"],
        "columns": ["version", "param.method"],
        "aggregate": ["count"],
        "better": ["higher"],
        "action": ["slam"],
        "version": ["2"],
        "query": ["alps"],
        "where": ["label.kind=se3", "robot=x"],
        "topic": ["/a"],
        "all_rows": ["true"],
    }


def test_a_table_is_written_for_papers_and_programs() -> None:
    def run(*arguments: str) -> str:
        with scripted(_table(*_ROWS)) as script:
            return klein(script, "metrics", "table", "--metric", "ate_rmse", *arguments).stdout

    assert "  n\\_1 & 1.000 & failed \\\\\n" in run("--format", "latex")
    assert "  day & 0.30 & \\textbf{0.012} \\\\\n" in run("--format", "latex", "--digits", "2")
    assert "| day | 0.3000 | **0.01235** |\n" in run("--format", "markdown")
    assert run("--format", "csv") == "mission,slam@1,slam@2\nday,0.30000000000000004,0.012345\nn_1,1.0,\n"
    assert json.loads(run("--format", "json")) == json.loads(run("--json"))
    assert json.loads(run("--json"))["rows"][1]["cells"][1]["missing"] == "failed"


def test_wrong_options_are_refused_before_a_request() -> None:
    with scripted() as script:
        for wrong in (("--columns", "param"), ("--rows", "a..b")):
            refused = klein(script, "metrics", "table", "--metric", "ate", *wrong)
            assert isinstance(refused.exception, InvalidInput), refused
    assert script.requests == []


def test_metrics_are_listed_as_actions_declare_them() -> None:
    ate = MetricName(name="ate", unit="m", better=Better.lower, description="Error.", run_count=3)
    size = MetricName(name="size", unit=None, better=Better.none, description="", run_count=1)
    with scripted(MetricNames(items=[ate, size], truncated=True)) as script:
        ran = klein(script, "metrics", "list", "--action", "slam*")
    assert ran.stdout.splitlines()[1:] == ["ate     m     lower      3  Error.", "size    -     -          1"]
    assert "There are more than 2 metrics" in ran.stderr
    assert _query(script) == {"action": ["slam*"]}


def test_statistics_are_tables_for_papers_with_units() -> None:
    row = StatsRow(
        group="al_ps", missions=2, files=3, recordings=2, size_bytes=1_500_000_000, duration_ns=3 * _HOURS, messages=12
    )
    read = StatsRead(by="project", rows=[row], total=row)
    with scripted(read, read, read) as script:
        latex = klein(script, "stats", "--latex").stdout
        markdown = klein(script, "stats", "--markdown").stdout
        assert isinstance(klein(script, "stats", "--latex", "--csv").exception, InvalidInput)
    assert "  project & missions & files & recordings & duration {[}h] & size {[}GB] & messages \\\\\n" in latex
    assert "  al\\_ps & 2 & 3 & 2 & 3.000 & 1.500 & 12 \\\\\n  \\midrule\n  total & 2 &" in latex
    assert "| al\\_ps | 2 | 3 | 2 | 3.000 | 1.500 | 12 |\n" in markdown


def test_the_sdk_returns_tables_that_become_frames() -> None:
    pandas = pytest.importorskip("pandas")
    with scripted(_table(*_ROWS, comparison=_COMPARED)) as script, client_of(script) as client:
        table = client.metrics.table("ate_rmse", rows="meta.robot", columns="action,version", where="robot=x")
    assert _query(script) == {"metric": ["ate_rmse"], "rows": ["metadata.robot"], "where": ["robot=x"]}
    frame = table.to_pandas()
    assert [*frame.columns] == ["slam@1", "slam@2", "difference"]
    assert (frame.index.name, [*frame.index]) == ("mission", ["day", "n_1"])
    assert frame.loc["day", "slam@2"] == 0.012345
    assert pandas.isna(frame.loc["n_1", "slam@2"])
    assert frame.attrs == {"metric": "ate_rmse", "unit": "m", "aggregate": "median", "better": "lower"}
    assert "\\textbf{0.012}" in table.to_latex(digits=2)
    assert table.to_csv().startswith("mission,slam@1")
    assert "**0.01235**" in table.to_markdown()
    assert "<td>failed</td>" in table._repr_html_()


def test_an_empty_table_is_an_empty_frame() -> None:
    pytest.importorskip("pandas")
    with scripted(_table()) as script, client_of(script) as client:
        frame = client.metrics.table("ate_rmse").to_pandas()
    assert (frame.shape, frame.index.name) == ((0, 2), "mission")


def test_without_pandas_the_error_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with scripted(_table(*_ROWS)) as script, client_of(script) as client:
        table = client.metrics.table("ate_rmse")
    with pytest.raises(ReadingMissing, match="reading"):
        table.to_pandas()
