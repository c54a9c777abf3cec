"""Tables of metrics: which results are in them, missing cells, ranks, comparison, bounds, rights and formats."""

import uuid
from dataclasses import dataclass, field
from typing import Any

import pytest

from kleinkram.contract.access import Right
from kleinkram.server.runs import metric_tables
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, definition
from tests.integration.upload_client import upload

ATE = {"name": "ate", "unit": "m", "better": "lower", "description": "Absolute trajectory error."}


@dataclass
class Lab:
    """A project with missions, and an action whose runs report what a test says."""

    api: Api
    runner: FakeRunner
    project: Any
    action: Any
    published: dict[str, Any]
    missions: dict[str, Any] = field(default_factory=dict)

    def mission(self, name: str, **metadata: Any) -> str:
        """Create a mission with a file; return its id."""
        made = self.api.mission(self.project["id"], name=name, metadata=metadata)
        upload(self.api, made["id"], "drive.bin", uuid.uuid4().bytes)
        self.missions[name] = made["id"]
        return str(made["id"])

    def publish(self, **values: Any) -> None:
        """Publish a further version of the action."""
        self.published |= values
        self.api.post(f"/actions/{self.action['id']}/versions", {"definition": self.published}).ok(201)

    def launch(self, name: str, version: int | None = None, **parameters: Any) -> str:
        """Launch a run of the action on a mission; return its id."""
        body = {"mission_ids": [self.missions[name]], "action_id": self.action["id"], "parameters": parameters}
        (made,) = self.api.post("/runs", body | {"version": version, "force": True}).ok()["items"]
        assert made["outcome"] == "created", made
        return str(made["run"]["id"])

    def run(
        self, name: str, *values: float | dict[str, Any], version: int | None = None, end: str = "done", **set_to: Any
    ) -> str:
        """Run the action on a mission, with these values of `ate`, or metrics; return the id of the run."""
        run_id = self.launch(name, version, **set_to)
        metrics = [value if isinstance(value, dict) else {"name": "ate", "value": value} for value in values]
        self.runner.finish(
            self.runner.claim(),
            end,
            report={"metrics": metrics},
            exit_code=int(end != "done"),
            image_digest="sha256:stock",
        ).ok()
        return run_id

    def table(self, **query: Any) -> Any:
        """Return the table of `ate` in the project."""
        defaults = {"metric": "ate", "project_id": self.project["id"]}
        pairs = [(name, one) for name, value in (defaults | query).items() for one in _several(value)]
        return self.api.get("/metrics/table", pairs).ok()

    def refused(self, **query: Any) -> str:
        """Return the reason for which a table is refused."""
        defaults = {"metric": "ate", "project_id": self.project["id"]}
        pairs = [(name, one) for name, value in (defaults | query).items() for one in _several(value)]
        return str(self.api.get("/metrics/table", pairs).refused(422, "invalid_query")["detail"])


def _several(value: Any) -> list[str]:
    return [str(one) for one in (value if isinstance(value, list) else [value])]


def _values(table: Any) -> dict[str, list[Any]]:
    """Return the cells by row: values, and why there is none."""
    return {row["label"]: [_shown(cell) for cell in row["cells"]] for row in table["rows"]}


def _shown(cell: Any) -> Any:
    return cell["missing"] if cell["value"] is None else cell["value"]


def _labels(table: Any) -> list[str]:
    return [column["label"] for column in table["columns"]]


@pytest.fixture(name="work")
def _work(lab: Api, runner: FakeRunner) -> Lab:
    project = lab.project()
    parameters = [
        {"name": "method", "type": "string", "default": "kiss"},
        {"name": "voxel", "type": "number", "default": 0.5},
    ]
    published = definition(runner, parameters=parameters, metrics=[ATE]) | {"name": f"slam-{uuid.uuid4().hex[:6]}"}
    action = lab.post("/actions", {"project_id": project["id"], "definition": published}).ok(201)
    return Lab(lab, runner, project, action, published)


def test_missions_by_version_with_units_best_values_and_comparison(work: Lab) -> None:
    for name in ("b", "a", "c"):
        work.mission(name)
    name = work.published["name"]
    first = work.run("a", 1)
    work.run("b", 2)
    work.run("c", 3)
    work.publish(description="better")
    for mission, value in (("a", 0.5), ("b", 4), ("c", 3)):
        work.run(mission, value)
    table = work.table(compare=[f"{name}@1", f"{name}@2"])
    assert (table["unit"], table["better"], table["description"]) == ("m", "lower", ATE["description"])
    assert _labels(table) == [f"{name}@1", f"{name}@2"]
    assert table["columns"][0] | {"label": ""} == {
        "label": "",
        "values": {"action": name, "version": 1},
        "action_id": work.action["id"],
    }
    assert list(_values(table).items()) == [("a", [1, 0.5]), ("b", [2, 4]), ("c", [3, 3])]
    assert table["rows"][0]["mission"]["id"] == work.missions["a"]
    cell = table["rows"][0]["cells"][0]
    assert cell == {
        "value": 1,
        "missing": None,
        "count": 1,
        "run_count": 1,
        "run_ids": [first],
        "rank": "worst",
    }
    assert [[cell["rank"] for cell in row["cells"]] for row in table["rows"]] == [
        ["worst", "best"],
        ["best", "worst"],
        [None, None],
    ]
    assert table["comparison"] == {
        "first": 0,
        "second": 1,
        "differences": [-0.5, 2, 0],
        "pair_count": 3,
        "median_difference": 0,
        "mean_difference": 0.5,
        "wins": 1,
        "losses": 1,
        "ties": 1,
    }
    other_way = work.table(better="higher", compare=[f"{name}@2", f"{name}@1"])["comparison"]
    assert (other_way["differences"], other_way["wins"], other_way["losses"]) == ([0.5, -2, 0], 1, 1)
    undecided = work.table(better="none", compare=[f"{name}@1", f"{name}@2"])
    assert (undecided["comparison"]["wins"], undecided["comparison"]["losses"]) == (None, None)
    assert {cell["rank"] for row in undecided["rows"] for cell in row["cells"]} == {None}


def test_only_results_that_count_are_in_a_table(work: Lab) -> None:
    work.mission("a")
    work.run("a", 9)
    latest = work.run("a", 1)
    work.run("a", 7, end="exit_code")
    table = work.table()
    assert _values(table) == {"a": [1]}
    assert table["rows"][0]["cells"][0]["run_ids"] == [latest]
    work.run("a", 5, method="odometry")
    assert _values(work.table())["a"] == [3], "both parameters count"
    assert work.table()["varying"] == ["param.method"]
    work.publish(description="better")
    work.run("a", 2)
    # Without the version as a column, a later version replaces an earlier one.
    by_method = work.table(columns=["param.method"])
    assert (_labels(by_method), _values(by_method)) == (["method=kiss", "method=odometry"], {"a": [2, 5]})
    assert _values(work.table(columns=["version", "param.method"])) == {"a": [1, 5, 2]}
    assert _values(work.table(columns=["param.method"], version=1)) == {"a": [1, 5]}
    # Results that a run reuses are its own.
    body = {"mission_ids": [work.missions["a"]], "action_id": work.action["id"], "version": 1}
    (reused,) = work.api.post("/runs", body).ok()["items"]
    assert reused["run"]["reuses_id"] == latest
    assert work.table(columns=["param.method"])["rows"][0]["cells"][0]["run_ids"] == [latest]


def test_missing_cells_say_why(work: Lab) -> None:
    for name in ("a", "b", "c", "d", "e"):
        work.mission(name)
    work.run("a", 1)
    failed = work.run("b", 2, end="exit_code")
    done = work.run("c", {"name": "other", "value": 1})
    cancelled = work.launch("d")
    work.api.post(f"/runs/{cancelled}/cancel").ok()
    work.publish(description="better")
    work.run("a", 2)
    running = work.launch("b")
    claim = work.runner.claim()
    table = work.table()
    assert _values(table) == {
        "a": [1, 2],
        "b": ["failed", "running"],
        "c": ["no_metric", "no_run"],
        "d": ["cancelled", "no_run"],
    }
    cells = [cell for row in table["rows"] for cell in row["cells"]]
    assert [cell["run_ids"] for cell in cells[2:]] == [[failed], [running], [done], [], [cancelled], []]
    assert _values(work.table(all_rows="true"))["e"] == ["no_run", "no_run"]
    work.runner.finish(claim).ok()
    assert _values(work.table())["b"] == ["failed", "no_metric"]


def test_a_version_that_always_fails_has_a_column(work: Lab) -> None:
    work.mission("a")
    work.run("a", 1, end="exit_code")
    table = work.table()
    assert (len(table["columns"]), _values(table)) == (1, {"a": ["failed"]})
    assert work.table(columns=["label.kind"])["columns"] == [
        {"label": "kind=-", "values": {"label.kind": None}, "action_id": None}
    ]


def test_aggregates_topics_and_labels(work: Lab) -> None:
    work.mission("a")
    values = [
        {"name": "ate", "value": value, "topic": topic, "labels": {"alignment": alignment}}
        for value, topic, alignment in ((1, "/a", "se3"), (2, "/a", "sim3"), (9, "/b", "se3"))
    ]
    work.run("a", *values)
    expected = {"median": 2, "mean": 4, "min": 1, "max": 9, "latest": 9, "count": 3}
    assert {name: _values(work.table(aggregate=name))["a"][0] for name in expected} == expected
    assert work.table()["varying"] == ["label.alignment", "topic"]
    assert work.table()["dimensions"] == [
        {"name": "label.alignment", "value_count": 2},
        {"name": "topic", "value_count": 2},
    ]
    both = work.table(columns=["topic", "label.alignment"])
    assert _labels(both) == ["/a, alignment=se3", "/a, alignment=sim3", "/b, alignment=se3"]
    assert (_values(both), both["varying"]) == ({"a": [1, 2, 9]}, [])
    assert _values(work.table(topic="/a")) == {"a": [1.5]}
    assert _values(work.table(where=["label.alignment=sim3"])) == {"a": [2]}
    assert _values(work.table(where=["label.alignment!=sim3", "param.voxel=0.5"])) == {"a": [5]}
    assert work.table(where=["param.voxel!=0.50"])["rows"] == []
    counted = work.table(aggregate="count")
    assert (counted["unit"], counted["better"]) == (None, "none")


def test_rows_are_projects_or_values_of_metadata(work: Lab) -> None:
    for name, robot, run in (("a", "anymal", 9), ("b", "anymal", 10), ("c", "spot", 10), ("d", None, 2)):
        work.mission(name, **({} if robot is None else {"robot": robot}), place={"run": run})
    for name, value in (("a", 1), ("b", 3), ("c", 4), ("d", 8)):
        work.run(name, value)
    by_robot = work.table(rows="metadata.robot", aggregate="mean")
    assert list(_values(by_robot).items()) == [("anymal", [2]), ("spot", [4]), (None, [8])]
    assert by_robot["rows"][0]["cells"][0]["run_count"] == 2
    assert [row["label"] for row in work.table(rows="metadata.place.run")["rows"]] == ["2", "9", "10"]
    by_project = work.table(rows="project")
    assert _values(by_project) == {work.project["name"]: [3.5]}
    assert by_project["rows"][0]["project"]["id"] == work.project["id"]
    assert _values(work.table(where=["robot=anymal"])) == {"a": [1], "b": [3]}
    assert _values(work.table(query="meta.robot:spot")) == {"c": [4]}
    assert _values(work.table(query="path:drive.bin meta.robot:spot")) == {"c": [4]}
    assert _values(work.table(mission_id=work.missions["d"])) == {"d": [8]}
    assert work.table(action="other*")["rows"] == []
    assert _values(work.table(action=work.published["name"], version=1))["a"] == [1]


def test_values_with_several_units_are_refused(work: Lab) -> None:
    for name in ("a", "b"):
        work.mission(name)
    work.run("a", 1)
    work.run("b", {"name": "ate", "value": 1, "unit": "mm"})
    assert "the units m and mm" in work.refused(), "the unit of the first is the declared one"
    assert work.table(mission_id=work.missions["b"])["unit"] == "mm"
    assert _values(work.table(aggregate="count")) == {"a": [1], "b": [1]}


def test_tables_that_are_too_large_are_refused(work: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b"):
        work.mission(name)
        work.run(name, 1)
    work.run("a", 1, method="x")
    monkeypatch.setattr(metric_tables, "MAX_COLUMNS", 1)
    assert "more than 1 columns" in work.refused(columns=["param.method"])
    monkeypatch.setattr(metric_tables, "MAX_ROWS", 1)
    assert "more than 1 rows" in work.refused()
    monkeypatch.undo()
    monkeypatch.setattr(metric_tables, "MAX_CELLS", 3)
    assert "4 cells" not in work.refused(columns=["param.method"])
    assert _values(work.table()) == {"a": [1], "b": [1]}


def test_what_a_table_cannot_use_is_refused_with_a_sentence(work: Lab) -> None:
    work.mission("a")
    work.run("a", 1)
    name = work.published["name"]
    assert f"the columns are {name}@1" in work.refused(compare=["nothing", f"{name}@1"])
    assert "= or !=" in work.refused(where=["param.voxel>1"])
    for wrong in ({"columns": "param"}, {"rows": "robot"}, {"columns": ["action", "action"]}, {"compare": "a"}):
        pairs = [("metric", "ate"), *((key, one) for key, value in wrong.items() for one in _several(value))]
        work.api.get("/metrics/table", pairs).refused(422, "invalid_request")


def test_equal_names_of_actions_make_columns_of_their_own(work: Lab) -> None:
    work.mission("a")
    work.run("a", 1)
    work.api.patch(f"/actions/{work.action['id']}", {"archived": True}).ok()
    work.action = work.api.post("/actions", {"project_id": work.project["id"], "definition": work.published}).ok(201)
    work.run("a", 2)
    table = work.table(columns=["action"])
    assert sorted(_values(table)["a"]) == [1, 2]
    assert len({*_labels(table)}) == 2
    unpublished = {"mission_ids": [work.missions["a"]], "definition": work.published, "force": True}
    work.api.post("/runs", unpublished).ok()
    work.runner.finish(work.runner.claim(), report={"metrics": [{"name": "ate", "value": 3}]}).ok()
    assert any(label.endswith(" unpublished") for label in _labels(work.table()))


def test_tables_and_names_show_only_what_one_may_see(work: Lab) -> None:
    for name in ("a", "b"):
        work.mission(name)
        work.run(name, 1)
    member, stranger = people.person(work.api), people.person(work.api, email=f"{uuid.uuid4().hex}@elsewhere.test")
    people.grant(work.api, member, Right.read, mission_id=work.missions["b"])
    whole = work.api
    work.api = whole.as_(member.token)
    assert [*_values(work.table())] == ["b"]
    assert [*_values(work.table(all_rows="true"))] == ["b"]
    (name,) = work.api.get("/metrics", {"project_id": work.project["id"]}).ok()["items"]
    assert name == {"name": "ate", "unit": "m", "better": "lower", "description": ATE["description"], "run_count": 1}
    work.api = whole.as_(stranger.token)
    assert (work.table()["rows"], work.table()["columns"]) == ([], [])
    assert work.api.get("/metrics", {"project_id": work.project["id"]}).ok()["items"] == []


def test_the_text_of_a_table_is_escaped_and_the_best_value_bold(work: Lab) -> None:
    work.mission("50%_a|b")
    name = work.published["name"]
    work.run("50%_a|b", 0.012345)
    work.publish(description="better")
    work.run("50%_a|b", 0.02)
    latex = work.table(text="latex", compare=[f"{name}@1", f"{name}@2"])["text"]
    assert "\\multicolumn{3}{c}{ate {[}m], median, lower is better}" in latex
    assert "  50\\%\\_a\\textbar{}b & \\textbf{0.01235} & 0.02000 & 0.007655 \\\\\n" in latex
    assert f"% {name}@2 against {name}@1: 1 pair, median difference 0.007655 m" in latex
    assert "0 wins, 1 loss, 0 ties" in latex
    markdown = work.table(text="markdown", digits=2)["text"]
    assert "| 50%\\_a\\|b | **0.012** | 0.020 |\n" in markdown
    assert work.table(text="csv")["text"].splitlines() == [f"mission,{name}@1,{name}@2", "50%_a|b,0.012345,0.02"]


def test_a_table_takes_a_constant_number_of_statements(work: Lab) -> None:
    counts = []
    for number in range(3):
        work.mission(f"m{number}")
        work.run(f"m{number}", number)
        with work.api.statements() as statements:
            work.table(all_rows="true")
        counts.append(len(statements))
    assert len(set(counts[1:])) == 1
    assert counts[-1] <= 12


def test_a_value_without_a_unit_has_that_of_its_own_version(work: Lab) -> None:
    """A second version in other units must not make the first one's values look a hundred times larger."""
    work.mission("a")
    work.run("a", 12)
    work.publish(metrics=[ATE | {"unit": "cm"}])
    work.run("a", 1200)
    assert "the units cm and m" in work.refused()
    assert [work.table(version=number)["unit"] for number in (1, 2)] == ["m", "cm"]
    assert work.api.get("/metrics", {"project_id": work.project["id"]}).ok()["items"][0]["unit"] == "cm"
    work.publish(metrics=[])
    work.run("a", {"name": "ate", "value": 1})
    assert work.table(version=3)["unit"] is None, "nothing says what it is"


def test_names_of_metrics_have_all_units_that_were_reported(work: Lab) -> None:
    work.mission("a")
    work.run("a", 1)
    work.run("a", {"name": "ate", "value": 1, "unit": "mm"})
    (item,) = work.api.get("/metrics", {"project_id": work.project["id"]}).ok()["items"]
    assert (item["unit"], item["run_count"]) == ("m, mm", 2)


def test_true_and_one_are_two_values_of_a_parameter(work: Lab) -> None:
    work.mission("a")
    for number, kind in ((1, "boolean"), (2, "integer"), (3, "number")):
        work.publish(parameters=[{"name": "deskew", "type": kind}])
        work.run("a", number, deskew=True if kind == "boolean" else 1)
    table = work.table(columns=["param.deskew"])
    assert _labels(table) == ["deskew=1", "deskew=true"]
    assert _values(table) == {"a": [3, 1]}, "1 and 1.0 are the same number, and its latest result counts"
    assert _values(work.table(where=["param.deskew=true"])) == {"a": [1]}


def test_parameters_and_comparisons_of_any_size_make_a_table(work: Lab) -> None:
    work.mission("a")
    work.publish(parameters=[{"name": "n", "type": "integer"}, {"name": "x", "type": "number", "default": 0.1 + 0.2}])
    work.run("a", 1, n=10**400)
    work.run("a", 2, n=-(10**400))
    work.run("a", 3, n=5, x=0.3)
    assert _values(work.table(columns=["param.n"])) == {"a": [2, 3, 1]}
    assert _labels(work.table(columns=["param.x"])) == ["x=0.3", "x=0.30000000000000004"]
    assert work.table(where=["param.n=1e999"])["rows"] == []
    assert work.table(where=['param.n="5"'])["rows"] == [], "in quotes, it is a text"
    assert _values(work.table(where=["param.n=5"])) == {"a": [3]}


def test_columns_that_differ_in_case_are_compared_as_they_are_named(work: Lab) -> None:
    work.mission("a")
    work.run("a", 1, method="ICP")
    work.run("a", 5, method="icp")
    table = work.table(columns=["param.method"], compare=["method=ICP", "method=icp"])
    compared = [table["columns"][table["comparison"][place]]["label"] for place in ("first", "second")]
    assert (compared, table["comparison"]["differences"]) == (["method=ICP", "method=icp"], [4])
    assert "several columns" in work.refused(columns=["param.method"], compare=["method=ICP", "METHOD=ICP"])
    same = work.refused(columns=["param.method"], compare=["method=ICP", "method=ICP"])
    assert "both names are of the column method=ICP" in same


def test_rows_without_runs_are_those_of_the_filter(work: Lab) -> None:
    for name in ("a", "b", "c"):
        work.mission(name)
    work.run("a", 1)
    for name in ("a", "b"):
        table = work.table(all_rows="true", mission_id=work.missions[name])
        assert [row["label"] for row in table["rows"]] == [name]
    assert [row["label"] for row in work.table(all_rows="true")["rows"]] == ["a", "b", "c"]


def test_metrics_of_any_accepted_size_can_be_aggregated_and_compared(work: Lab) -> None:
    for name, value in (("a", 1e150), ("b", -1e150)):
        work.mission(name)
        work.run(name, value)
        work.run(name, -value, method="other")
    table = work.table(columns=["param.method"], compare=["method=kiss", "method=other"])
    assert table["comparison"]["differences"] == [-2e150, 2e150]
    assert _values(work.table(rows="project", aggregate="mean")) == {work.project["name"]: [0]}
    work.launch("a", method="large")
    too_large = {"metrics": [{"name": "ate", "value": 1e151}]}
    work.runner.finish(work.runner.claim(), report=too_large).refused(422, "invalid_request")
