"""Required metadata: validated by the server first, with all problems reported at once."""

import math

import pytest

from tests.integration.api_server import Api

FIELDS = """\
undeclared: refuse
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true, description: Who walked.}
  - {name: operator, type: string, pattern: '[a-z]+', required: true}
  - {name: temperature, type: number, unit: degC, default: 12.5 degC}
  - {name: indoors, type: boolean}
  - {name: day, type: date}
  - {name: site, type: location}
  - {name: report, type: link}
"""


@pytest.fixture(scope="module")
def project_id(api: Api) -> str:
    made: str = api.project(fields_yaml=FIELDS)["id"]
    return made


def test_valid_metadata_are_stored_in_canonical_form(api: Api, project_id: str) -> None:
    text = (
        "robot: anymal\noperator: ada\ntemperature: -3.5 degC\nindoors: false\nday: 2024-05-31 14:00+02:00\n"
        "site: {latitude: 47.4, longitude: 8}\nreport: https://example.org/a?b=c\n"
    )
    made = api.mission(project_id, metadata_yaml=text)
    assert made["metadata"] == {
        "robot": "anymal",
        "operator": "ada",
        "temperature": -3.5,
        "indoors": False,
        "day": "2024-05-31T12:00:00+00:00",
        "site": {"latitude": 47.4, "longitude": 8.0},
        "report": "https://example.org/a?b=c",
    }
    assert made["metadata_yaml"] == text


def test_omitted_fields_take_their_default(api: Api, project_id: str) -> None:
    made = api.mission(project_id, metadata_yaml="robot: spot\noperator: ada\nday:\nsite: Zürich\n")
    assert made["metadata"] == {"robot": "spot", "operator": "ada", "temperature": 12.5, "site": "Zürich"}


def test_without_metadata_all_that_is_required_is_named(api: Api, project_id: str) -> None:
    path = f"/projects/{project_id}/missions"
    for body in (
        {"name": "never"},
        {"name": "never", "metadata_yaml": ""},
        {"name": "never", "metadata_yaml": "# -\n"},
    ):
        problem = api.post(path, body).refused(422, "metadata_invalid")
        assert [one["field"] for one in problem["problems"]] == ["robot", "operator"]
        assert "anymal, spot" in problem["detail"]
    assert api.all("/missions", {"project_id": project_id, "name": "never"}) == []


def test_all_problems_are_reported_at_once_with_their_place(api: Api, project_id: str) -> None:
    text = (
        "robt: anymal\n"
        "operator: Ada\n"
        "temperature: 20 K\n"
        "indoors: yes\n"
        "day: 31.5.2024\n"
        "site: {latitude: 91, longitude: 8}\n"
        "report: ftp://example.org\n"
    )
    body = {"name": "never", "metadata_yaml": text}
    problem = api.post(f"/projects/{project_id}/missions", body).refused(422, "metadata_invalid")
    reply = [(one["field"], one.get("line"), one.get("column")) for one in problem["problems"]]
    assert reply == [
        ("robt", 1, 1),
        ("operator", 2, 1),
        ("temperature", 3, 1),
        ("indoors", 4, 1),
        ("day", 5, 1),
        ("site.latitude", 6, 8),
        ("report", 7, 1),
        ("robot", None, None),
    ]
    messages = {one["field"]: one["message"] for one in problem["problems"]}
    assert "'robot'" in messages["robt"]
    assert "'degC'" in messages["temperature"]


@pytest.mark.parametrize(
    ("line", "field", "word"),
    [
        ("temperature: warm", "temperature", "number"),
        ("temperature: true", "temperature", "number"),
        ("temperature: .nan", "temperature", "finite"),
        ("temperature: -.inf", "temperature", "finite"),
        ("temperature: 1e999", "temperature", "finite"),
        ("temperature: [1]", "temperature", "list"),
        ("operator: 7", "operator", "quotes"),
        ('operator: "ada\\n"', "operator", "pattern"),
        ("indoors: 1", "indoors", "true or false"),
        ("day: 2024-02-30", "day", "date"),
        ("day: 2024", "day", "date"),
        ("site: {latitude: 1}", "site.longitude", "required"),
        ("site: {latitude: 1, longitude: .nan}", "site.longitude", "finite"),
        ("site: 5", "site", "place"),
        ("report: example.org", "report", "address"),
        ("robot: anymall", "robot", "'anymal'"),
        ("Robot: anymal", "Robot", "'robot'"),
    ],
)
def test_a_wrong_value_is_named(api: Api, project_id: str, line: str, field: str, word: str) -> None:
    good = {"robot": "robot: spot", "operator": "operator: ada"}
    passed = [text for name, text in good.items() if name != line.split(":")[0].lower()]
    problem = api.post(
        f"/projects/{project_id}/missions", {"name": "never", "metadata_yaml": "\n".join([*passed, line])}
    ).refused(422, "metadata_invalid")
    first = problem["problems"][0]
    assert first["field"] == field
    assert word in first["message"]
    assert first["line"] == len(passed) + 1


@pytest.mark.parametrize(
    ("text", "line", "column", "word"),
    [
        ("robot: [anymal\n", 2, 1, "expected"),
        ("robot: anymal\n\toperator: ada\n", 2, 1, "cannot start any token"),
        ("robot: spot: anymal\n", 1, 12, "not allowed"),
        ("robot: spot\nrobot: anymal\n", 2, 1, "twice"),
        ("a: &x [1]\nb: *x\n", 1, 4, "anchors"),
        ("a: !!python/object:os.system x\n", 1, 4, "tags"),
        ("- a\n- b\n", 1, 1, "list"),
        ("a\x00b: 1\n", 1, 2, "U+0000"),
        ('a: "\\0"\n', 1, 4, "U+0000"),
        ('a: "\\ud800"\n', 1, 4, "U+D800"),
        ("a: 1\n---\nb: 2\n", 2, 1, "second document"),
        ("a: " + "[" * 100, 1, 24, "nested"),
        ("a: 99999999999999999999\n", 1, 4, "too large"),
        ("? [a]\n: b\n", 1, 3, "key"),
    ],
)
def test_yaml_that_cannot_be_read_names_line_and_column(api: Api, text: str, line: int, column: int, word: str) -> None:
    body = {"name": "never", "metadata_yaml": text}
    problem = api.post(f"/projects/{api.project()['id']}/missions", body).refused(422, "yaml_invalid")
    assert (problem["line"], problem["column"]) == (line, column)
    assert word in problem["reason"]


def test_undeclared_fields_are_stored_where_the_project_accepts_them(api: Api) -> None:
    text = "wheels: [4, {size: 1.5}]\nserial: '007'\nempty: null\nyes: no\n"
    made = api.mission(api.project()["id"], metadata_yaml=text)
    assert made["metadata"] == {"wheels": [4, {"size": 1.5}], "serial": "007", "empty": None, "yes": "no"}
    assert math.isclose(made["metadata"]["wheels"][1]["size"], 1.5)


def test_undeclared_numbers_must_be_finite(api: Api) -> None:
    body = {"name": "never", "metadata_yaml": "a: {b: [.inf]}\n"}
    problem = api.post(f"/projects/{api.project()['id']}/missions", body).refused(422, "metadata_invalid")
    assert [one["field"] for one in problem["problems"]] == ["a.b.0"]


def test_a_text_longer_than_allowed_is_refused(api: Api) -> None:
    body = {"name": "never", "metadata_yaml": "#" * 200_001}
    problem = api.post(f"/projects/{api.project()['id']}/missions", body).refused(422, "invalid_request")
    assert problem["problems"][0]["field"] == "body.metadata_yaml"


def test_wrong_metadata_leaves_a_mission_as_it_was(api: Api, project_id: str) -> None:
    made = api.mission(project_id, metadata_yaml="robot: spot\noperator: ada\n")
    api.patch(f"/missions/{made['id']}", {"name": "other", "metadata_yaml": "robot: x\n"}).refused(
        422, "metadata_invalid"
    )
    assert api.get(f"/missions/{made['id']}").ok() == made


def test_the_same_metadata_is_judged_anew_by_changed_fields(api: Api) -> None:
    project = api.project()
    made = api.mission(project["id"], metadata_yaml="colour: red\n")
    api.patch(f"/projects/{project['id']}", {"fields_yaml": FIELDS}).ok()
    answer = api.patch(f"/missions/{made['id']}", {"metadata_yaml": "colour: red\n"})
    problem = answer.refused(422, "metadata_invalid")
    assert [one["field"] for one in problem["problems"]] == ["colour", "robot", "operator"]


def test_the_template_is_valid_once_the_required_fields_are_filled_in(api: Api) -> None:
    project = api.project(fields_yaml=FIELDS)
    template = api.get(f"/projects/{project['id']}/template").ok()
    assert template["prefilled_from"] is None
    assert "# robot (required): one of: anymal, spot\n#   Who walked.\nrobot:\n" in template["yaml"]
    assert "# temperature (optional): a number in degC\ntemperature: 12.5\n" in template["yaml"]
    filled = template["yaml"].replace("robot:\n", "robot: spot\n").replace("operator:\n", "operator: ada\n")
    made = api.mission(project["id"], metadata_yaml=filled)
    assert made["metadata"] == {"robot": "spot", "operator": "ada", "temperature": 12.5}


def test_the_template_suggests_values_of_the_last_mission_as_comments(api: Api) -> None:
    project = api.project(fields_yaml=FIELDS)
    api.mission(project["id"], metadata_yaml="robot: anymal\noperator: bob\n")
    text = 'robot: spot\noperator: ada\nday: 2024-05-31\nsite: {latitude: 1, longitude: 2, name: "a: b # c 🗻"}\n'
    last = api.mission(project["id"], metadata_yaml=text)
    template = api.get(f"/projects/{project['id']}/template").ok()
    assert template["prefilled_from"]["id"] == last["id"]
    assert template["values"] == {"temperature": 12.5}, "what the project itself says to begin with"
    assert template["carried"] == {key: last["metadata"][key] for key in ("robot", "site")}
    assert f"#   In mission {last['name']}: spot\nrobot:\n" in template["yaml"]
    assert ": ada" not in template["yaml"]
    body = {"name": "unread", "metadata_yaml": template["yaml"]}
    problem = api.post(f"/projects/{project['id']}/missions", body).refused(422, "metadata_invalid")
    assert {item["field"] for item in problem["problems"]} == {"robot", "operator"}


def test_the_template_leaves_out_what_no_longer_fits_and_suggests_what_was_not_declared(api: Api) -> None:
    project = api.project()
    api.mission(project["id"], metadata_yaml='robot: husky\n"on: #1": [a, {b: "true"}]\n')
    fields = "fields:\n  - {name: robot, type: choice, choices: [spot]}\n"
    api.patch(f"/projects/{project['id']}", {"fields_yaml": fields}).ok()
    template = api.get(f"/projects/{project['id']}/template").ok()
    assert template["carried"] == {"on: #1": ["a", {"b": "true"}]}
    assert api.mission(project["id"], metadata_yaml=template["yaml"])["metadata"] == {}
    taken = template["yaml"].replace('# "on: #1":', '"on: #1":')
    assert api.mission(project["id"], metadata_yaml=taken)["metadata"] == {"on: #1": ["a", {"b": "true"}]}


def test_the_number_and_cost_of_hints_are_bounded(api: Api) -> None:
    project_id = api.project(fields_yaml="undeclared: refuse\nfields:\n  - {name: robot, type: string}\n")["id"]
    body = {"name": "never", "metadata_yaml": "".join(f"robots{number}: x\n" for number in range(1000))}
    problem = api.post(f"/projects/{project_id}/missions", body).refused(422, "metadata_invalid")
    hinted = [one for one in problem["problems"] if "did you mean 'robot'?" in one["message"]]
    assert (len(problem["problems"]), len(hinted)) == (1000, 10)


def test_many_choices_are_named_in_part_and_one_has_its_length(api: Api) -> None:
    fields = (
        f"fields:\n  - {{name: robot, type: choice, choices: [{', '.join(f'spot{n}' for n in range(100, 200))}]}}\n"
    )
    project_id = api.project(fields_yaml=fields)["id"]
    body = {"name": "never", "metadata_yaml": "robot: spt190\n"}
    (one,) = api.post(f"/projects/{project_id}/missions", body).refused(422, "metadata_invalid")["problems"]
    assert one["message"].endswith("spot118, spot119 and 80 more; did you mean 'spot190'?")
    fields = f"fields:\n  - {{name: robot, type: choice, choices: [{'x' * 201}]}}\n"
    problem = api.patch(f"/projects/{project_id}", {"fields_yaml": fields}).refused(422, "fields_invalid")
    assert [one["field"] for one in problem["problems"]] == ["robot.choices.0"]


def test_a_form_receives_the_problems_of_each_field(api: Api, project_id: str) -> None:
    path = f"/projects/{project_id}/missions"
    wrong = {"robot": "anymall", "operator": 7, "site": {"latitude": 91, "longitude": 8}, "day": None}
    problem = api.post(path, {"name": "never", "metadata": wrong}).refused(422, "metadata_invalid")
    assert {one["field"] for one in problem["problems"]} == {"robot", "operator", "site.latitude"}
    made = api.mission(project_id, metadata={"robot": "spot", "operator": "ada", "temperature": "20 degC"})
    assert made["metadata"] == {"robot": "spot", "operator": "ada", "temperature": 20}
    assert made["metadata_yaml"] is None


def test_a_field_is_changed_by_itself(api: Api, project_id: str) -> None:
    made = api.mission(project_id, metadata_yaml="robot: spot\noperator: ada # by hand\nindoors: true\n")
    path = f"/missions/{made['id']}"
    changed = api.patch(path, {"metadata": {"operator": "bea", "indoors": None}}).ok()
    assert changed["metadata"] == {"robot": "spot", "operator": "bea", "temperature": 12.5}
    assert changed["metadata_yaml"] is None
    assert api.patch(path, {"metadata": {"operator": "bea"}}).ok()["metadata"] == changed["metadata"]
    assert [event["operation"] for event in api.events(made["id"])] == ["mission.update", "mission.create"]
    problem = api.patch(path, {"metadata": {"operator": None, "colour": "red"}}).refused(422, "metadata_invalid")
    assert {one["field"] for one in problem["problems"]} == {"operator", "colour"}
    assert api.get(path).ok()["metadata"] == changed["metadata"]


def test_changing_nothing_keeps_the_document(api: Api, project_id: str) -> None:
    made = api.mission(project_id, metadata_yaml="robot: spot\noperator: ada # by hand\n")
    same = api.patch(f"/missions/{made['id']}", {"metadata": {"operator": "ada"}}).ok()
    assert same["metadata_yaml"] == made["metadata_yaml"]


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"note": "a\x00b"}, "U+0000"),
        ({"x" * 201: 1}, "characters"),
        ({"note": [[[[[[[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]]]]]]}, "nested"),
        ({"note": list(range(20_001))}, "values"),
        ({"note": "x" * 200_001}, "characters"),
    ],
)
def test_metadata_values_that_cannot_be_stored_are_refused(
    api: Api, project_id: str, values: object, word: str
) -> None:
    body = {"name": "never", "metadata": values}
    problem = api.post(f"/projects/{project_id}/missions", body).refused(422, "invalid_request")
    assert word in problem["problems"][0]["message"]


def test_metadata_are_accepted_in_one_way_only(api: Api, project_id: str) -> None:
    body = {"name": "never", "metadata": {"robot": "spot"}, "metadata_yaml": "robot: spot"}
    problem = api.post(f"/projects/{project_id}/missions", body).refused(422, "invalid_request")
    assert "not both" in problem["problems"][0]["message"]


def test_a_template_is_a_form_too(api: Api) -> None:
    project_id = api.project(fields_yaml=FIELDS)["id"]
    form = api.get(f"/projects/{project_id}/template").ok()
    assert [field["name"] for field in form["fields"]["fields"]][:2] == ["robot", "operator"]
    assert form["values"] == {"temperature": 12.5}
    api.mission(project_id, metadata={"robot": "spot", "operator": "ada"})
    suggested = api.get(f"/projects/{project_id}/template").ok()
    assert (suggested["values"], suggested["carried"]) == ({"temperature": 12.5}, {"robot": "spot"})
    api.mission(project_id, metadata=suggested["carried"] | {"operator": "bob"})


@pytest.mark.parametrize("text", ["robot: spot\r\n# noted by hand\r\nsite: a\r\n", "\ufeffrobot: spot\n"])
def test_metadata_are_stored_verbatim(api: Api, text: str) -> None:
    made = api.mission(api.project()["id"], metadata_yaml=text)
    assert made["metadata_yaml"] == text
    assert made["metadata"]["robot"] == "spot"
