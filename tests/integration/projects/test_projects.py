"""Projects through HTTP."""

import base64
import json
import uuid

import pytest

from tests.integration.api_server import Api
from tests.integration.sample import Sample

FIELDS = """\
undeclared: refuse
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true}
  - {name: temperature, type: number, unit: degC}
"""


def test_a_project_is_created_and_read(api: Api) -> None:
    name = f"Field day {uuid.uuid4()} 🤖"
    made = api.post("/projects", {"name": name, "description": "Zürich"}).ok(201)
    assert (made["name"], made["description"], made["created_by"]["name"]) == (name, "Zürich", "owner")
    assert made["metadata_fields"] == {"fields": [], "undeclared": "accept"}
    amounts = ("mission_count", "file_count", "size_bytes", "duration_ns", "unsatisfied_mission_count")
    assert [made[amount] for amount in amounts] == [0, 0, 0, 0, 0]
    assert api.get(f"/projects/{made['id']}").ok() == made


def test_each_change_is_one_audit_row(api: Api) -> None:
    made = api.project(description="old")
    path = f"/projects/{made['id']}"
    api.patch(path, {"description": "new"}).ok()
    api.patch(path, {"description": "new"}).ok()
    api.delete(path, {"dry_run": "true"}).ok()
    api.delete(path).ok()
    events = api.events(made["id"])
    assert [event["operation"] for event in events] == ["project.delete", "project.update", "project.create"]
    assert (events[1]["before"], events[1]["after"]) == ({"description": "old"}, {"description": "new"})
    assert {event["actor"]["name"] for event in events} == {"owner"}
    assert all(event["request_id"] for event in events)


def test_project_names_are_unique_ignoring_case_and_unicode_form(api: Api) -> None:
    tail = uuid.uuid4().hex
    api.post("/projects", {"name": f"Zu\u0308rich {tail}"}).ok(201)
    problem = api.post("/projects", {"name": f"ZÜRICH {tail}"}).refused(409, "name_taken")
    assert problem["name"] == f"ZÜRICH {tail}"
    assert len(api.all("/projects", {"name": f"zürich {tail}"})) == 1
    other = api.project()
    api.patch(f"/projects/{other['id']}", {"name": f"zürich {tail}"}).refused(409, "name_taken")
    assert api.get(f"/projects/{other['id']}").ok()["name"] == other["name"]
    assert len(api.events(other["id"])) == 1


def test_a_name_may_change_its_case(api: Api) -> None:
    made = api.project(name=f"alps {uuid.uuid4()}")
    renamed = api.patch(f"/projects/{made['id']}", {"name": made["name"].upper()}).ok()
    assert renamed["name"] == made["name"].upper()


@pytest.mark.parametrize(
    "name",
    ["", " ", "a\nb", "a\x00b", "x" * 300, "..", "a/b", "a*", "\u202eevil", str(uuid.uuid4()), "\ud800"],
    ids=["empty", "blank", "newline", "nul", "long", "dots", "slash", "star", "bidi", "id", "surrogate"],
)
def test_an_invalid_name_is_refused_with_its_field(api: Api, name: str) -> None:
    problem = api.post("/projects", {"name": name}).refused(422, "invalid_request")
    assert [one["field"] for one in problem["problems"]] == ["body.name"]


def test_unknown_fields_are_refused(api: Api) -> None:
    problem = api.post("/projects", {"name": "x", "colour": "red"}).refused(422, "invalid_request")
    assert problem["problems"][0]["field"] == "body.colour"
    api.get("/projects", {"colour": "red"}).refused(422, "invalid_request")
    api.post("/projects", {"name": "x", "description": "a\x00b"}).refused(422, "invalid_request")


def test_unknown_credentials_are_refused(api: Api) -> None:
    refused = api.call("GET", "/projects", headers={"Authorization": "Bearer wrong"}).refused(401, "not_authenticated")
    assert "token" in refused["detail"]


def test_an_unknown_id_is_not_found(api: Api) -> None:
    unknown = uuid.uuid4()
    for answer in (
        api.get(f"/projects/{unknown}"),
        api.patch(f"/projects/{unknown}", {"description": "x"}),
        api.delete(f"/projects/{unknown}"),
        api.get(f"/projects/{unknown}/template"),
        api.post(f"/projects/{unknown}/missions", {"name": "x"}),
    ):
        assert answer.refused(404, "not_found")["ref"] == str(unknown)
    api.get("/projects/no-id").refused(422, "invalid_request")
    api.call("PUT", f"/projects/{unknown}").refused(405, "method_not_allowed")


def test_declared_fields_keep_their_order(api: Api) -> None:
    made = api.project(fields_yaml=FIELDS)
    assert made["metadata_fields"]["undeclared"] == "refuse"
    assert [field["name"] for field in made["metadata_fields"]["fields"]] == ["robot", "temperature"]
    created = api.events(made["id"])[0]
    assert created["after"]["metadata_fields"]["fields"][1]["unit"] == "degC"


def test_all_invalid_fields_are_named_with_their_position(api: Api) -> None:
    text = (
        "fields:\n"
        "  - {name: a, type: string, pattern: '('}\n"
        "  - {name: b, type: number, default: warm}\n"
        "  - {name: c, type: choice, choices: [x], default: y}\n"
    )
    problem = api.post("/projects", {"name": "never made", "fields_yaml": text}).refused(422, "fields_invalid")
    message = [(one["field"], one["line"], one["column"]) for one in problem["problems"]]
    assert message == [("a.pattern", 2, 29), ("b.default", 3, 29), ("c.default", 4, 43)]
    assert api.all("/projects", {"name": "never made"}) == []


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("fields:\n  - {name: 1a, type: string}\n", "1a.name"),
        ("fields:\n  - {name: a, type: colour}\n", "a.type"),
        ("fields:\n  - {name: a, type: string, unit: m}\n", "a"),
        ("fields:\n  - {name: a, type: choice}\n", "a"),
        ("fields:\n  - {name: a, type: link}\n  - {name: A, type: link}\n", "A.name"),
        ("fields:\n  - {name: a, type: number, default: [1]}\n", "a.default"),
        ("fields:\n  - {name: a, type: string, pattern: 'a)|(b'}\n", "a.pattern"),
        ("undeclared: maybe\n", "undeclared"),
        ("- a\n", "fields.yaml"),
    ],
)
def test_a_wrong_field_is_named(api: Api, text: str, field: str) -> None:
    problem = api.post("/projects", {"name": "never made", "fields_yaml": text}).refused(422, "fields_invalid")
    assert [one["field"] for one in problem["problems"]] == [field]


def test_yaml_errors_in_fields_have_line_and_column(api: Api) -> None:
    problem = api.post("/projects", {"name": "x", "fields_yaml": "fields:\n\t- a\n"}).refused(422, "yaml_invalid")
    assert (problem["line"], problem["column"]) == (2, 1)


def test_changed_fields_report_missions_without_changing_them(api: Api) -> None:
    project = api.project()
    good = api.mission(project["id"], metadata_yaml="robot: spot\n")
    bad = api.mission(project["id"], metadata_yaml="robot: husky\ncolour: red\n")
    changed = api.patch(f"/projects/{project['id']}", {"fields_yaml": FIELDS}).ok()
    assert (changed["mission_count"], changed["unsatisfied_mission_count"]) == (2, 1)
    assert api.get(f"/missions/{good['id']}").ok()["metadata_problems"] == []
    message = api.get(f"/missions/{bad['id']}").ok()
    assert sorted(one["field"] for one in message["metadata_problems"]) == ["colour", "robot"]
    assert message["metadata"] == {"robot": "husky", "colour": "red"}
    unsatisfied = api.all("/missions", {"project_id": project["id"], "satisfied": "false"})
    assert [mission["id"] for mission in unsatisfied] == [bad["id"]]
    again = api.patch(f"/projects/{project['id']}", {"fields_yaml": "fields: []"}).ok()
    assert again["unsatisfied_mission_count"] == 0


def test_changed_fields_judge_more_missions_than_fit_one_batch(api: Api) -> None:
    project = api.project()
    api.mission(project["id"], name="copied")
    columns = "project_id, name_key, metadata, notes, created_by_id"
    api.sql(
        f"INSERT INTO mission (id, name, {columns}) SELECT gen_random_uuid(), 'copy ' || n, project_id,"
        " 'copy ' || n, metadata, notes, created_by_id FROM mission, generate_series(1, 1001) n WHERE project_id = %s",
        project["id"],
    )
    changed = api.patch(f"/projects/{project['id']}", {"fields_yaml": FIELDS}).ok()
    assert (changed["mission_count"], changed["unsatisfied_mission_count"]) == (1002, 1002)


def test_project_counts_exclude_the_trash(api: Api, sample: Sample) -> None:
    project = api.project()
    remaining, gone = (api.mission(project["id"])["id"] for _ in range(2))
    files = [sample.file(remaining, "a.mcap", size_bytes=10), sample.file(remaining, "b.mcap", size_bytes=20)]
    sample.recording(remaining, "a", files, start_ns=1_000, end_ns=4_000)
    sample.recording(gone, "c", [sample.file(gone, "c.mcap", size_bytes=40)], start_ns=0, end_ns=9)
    api.delete(f"/missions/{gone}").ok()
    seen = api.get(f"/projects/{project['id']}").ok()
    assert (seen["mission_count"], seen["file_count"], seen["size_bytes"], seen["duration_ns"]) == (1, 2, 30, 3_000)


def test_deleting_a_project_hides_its_contents_and_frees_its_name(api: Api, sample: Sample) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    file_id = sample.file(mission["id"], "a.mcap", size_bytes=7)
    expected = {"missions": 1, "files": 1, "size_bytes": 7, "read_by_runs": 0, "made_from_it": []}
    assert api.delete(f"/projects/{project['id']}", {"dry_run": "true"}).ok() == {**expected, "dry_run": True}
    assert api.get(f"/projects/{project['id']}").ok()["file_count"] == 1
    assert api.delete(f"/projects/{project['id']}").ok() == {**expected, "dry_run": False}
    for path in (f"/projects/{project['id']}", f"/missions/{mission['id']}", f"/files/{file_id}"):
        api.get(path).refused(404, "not_found")
    assert api.all("/files", {"project_id": project["id"]}) == []
    assert api.project(name=project["name"])["id"] != project["id"]


def test_projects_are_sorted_by_name_and_time_in_both_directions(api: Api) -> None:
    tail = uuid.uuid4().hex
    for letter in "bca":
        api.project(name=f"{letter} {tail}")
    for sort, expected in {"name": "abc", "-name": "cba", "created": "bca", "-created": "acb"}.items():
        listed = api.all("/projects", {"name": f"? {tail}", "sort": sort, "limit": "2"})
        assert "".join(project["name"][0] for project in listed) == expected


def test_globs_and_words_find_projects(api: Api) -> None:
    tail = uuid.uuid4().hex
    api.project(name=f"Alpine_run {tail}", description="with the 100% new lidar")
    assert len(api.all("/projects", {"name": f"ALPINE?RUN {tail}"})) == 1
    assert len(api.all("/projects", {"name": f"alpine*{tail}"})) == 1
    assert api.all("/projects", {"name": f"alpineXrun {tail}"}) == []
    assert api.all("/projects", {"name": tail}) == []
    assert len(api.all("/projects", {"text": f"{tail} LIDAR"})) == 1
    assert len(api.all("/projects", {"text": f"{tail} 100%"})) == 1
    assert api.all("/projects", {"text": f"{tail} 100_"}) == []


def test_all_rows_are_counted_on_request(api: Api) -> None:
    tail = uuid.uuid4().hex
    for number in range(3):
        api.project(name=f"{number} {tail}")
    page = api.get("/projects", {"name": f"* {tail}", "limit": "1", "count": "true"}).ok()
    assert (page["total"], len(page["items"])) == (3, 1)
    assert api.get("/projects", {"limit": "1"}).ok()["total"] is None


FORM = {
    "undeclared": "refuse",
    "fields": [
        {"name": "robot", "type": "choice", "choices": ["anymal", "spot"], "required": True, "description": "Who."},
        {"name": "temperature", "type": "number", "unit": "degC", "default": 12.5},
        {"name": "operator", "type": "string", "pattern": "[a-z]+"},
    ],
}


def test_fields_are_edited_in_a_form(api: Api) -> None:
    project = api.project(metadata_fields=FORM)
    locked = project["metadata_fields"]
    assert [(field["name"], field["type"], field["required"]) for field in locked["fields"]] == [
        ("robot", "choice", True),
        ("temperature", "number", False),
        ("operator", "string", False),
    ]
    path = f"/projects/{project['id']}"
    assert api.patch(path, {"metadata_fields": locked}).ok()["metadata_fields"] == locked
    assert [event["operation"] for event in api.events(project["id"])] == ["project.create"]
    mission = api.mission(project["id"], metadata={"robot": "spot"})
    fewer = {**locked, "fields": [{**locked["fields"][0], "choices": ["anymal"]}]}
    changed = api.patch(path, {"metadata_fields": fewer}).ok()
    assert [field["name"] for field in changed["metadata_fields"]["fields"]] == ["robot"]
    assert changed["unsatisfied_mission_count"] == 1
    problems = api.get(f"/missions/{mission['id']}").ok()["metadata_problems"]
    assert {one["field"] for one in problems} == {"robot", "temperature"}


def test_problems_of_a_form_name_their_field(api: Api) -> None:
    path = f"/projects/{api.project()['id']}"
    wrong = {"fields": [{"name": "a", "type": "string"}, {"name": "1b", "type": "choice", "unit": 5}]}
    problem = api.patch(path, {"metadata_fields": wrong}).refused(422, "invalid_request")
    assert {"body.metadata_fields.fields.1.name", "body.metadata_fields.fields.1.unit"} <= {
        one["field"] for one in problem["problems"]
    }
    wrong = {"fields": [{"name": "a", "type": "string", "pattern": "("}, {"name": "b", "type": "date", "default": 5}]}
    problem = api.patch(path, {"metadata_fields": wrong}).refused(422, "fields_invalid")
    assert [one["field"] for one in problem["problems"]] == ["fields.0.pattern", "fields.1.default"]
    both = {"metadata_fields": FORM, "fields_yaml": "fields: []"}
    assert "not both" in api.patch(path, both).refused(422, "invalid_request")["problems"][0]["message"]


@pytest.mark.parametrize("cursor", ["x", "AAAA", "W10", "WyJhIl0", "é"])
def test_a_made_up_cursor_is_refused(api: Api, cursor: str) -> None:
    api.get("/projects", {"cursor": cursor}).refused(422, "invalid_cursor")


@pytest.mark.parametrize("path", ["/projects", "/missions", "/files", "/topics", "/trash", "/audit"])
def test_a_cursor_nested_too_deep_is_refused(api: Api, path: str) -> None:
    cursor = base64.urlsafe_b64encode(b"[" * 20_000).decode()
    api.get(path, {"cursor": cursor}).refused(422, "invalid_cursor")


def test_a_cursor_of_another_list_is_refused(api: Api) -> None:
    tail = uuid.uuid4().hex
    for number in range(2):
        api.project(name=f"{number} {tail}")
    cursor = api.get("/projects", {"name": f"* {tail}", "limit": "1"}).ok()["next"]
    api.get("/projects", {"sort": "created", "cursor": cursor}).refused(422, "invalid_cursor")
    api.get("/missions", {"cursor": cursor}).refused(422, "invalid_cursor")


def test_the_number_of_queries_does_not_depend_on_the_length_of_a_list(api: Api) -> None:
    tail = uuid.uuid4().hex
    counts = []
    for number in range(3):
        api.mission(api.project(name=f"{number} {tail}")["id"])
        with api.statements() as statements:
            api.get("/projects", {"name": f"* {tail}"}).ok()
        counts.append(len(statements))
    assert counts == [2, 2, 2]


@pytest.mark.parametrize(
    "value",
    ["sa\x00b", "s\ud800", "i" + "9" * 30, "i5", f"u{uuid.UUID(int=5)}", "d2024-01-01", "x", ""],
    ids=["nul", "surrogate", "huge", "number", "id", "date", "nothing", "empty"],
)
@pytest.mark.parametrize("sort", ["name", "created"])
def test_a_forged_cursor_is_refused_or_shows_nothing_else(api: Api, sort: str, value: str) -> None:
    tail = uuid.uuid4().hex
    for number in range(2):
        api.project(name=f"{number} {tail}")
    query = {"name": f"* {tail}", "sort": sort, "limit": "1"}
    real = api.get("/projects", query).ok()["next"]
    signature, _, last = json.loads(base64.urlsafe_b64decode(real + "=" * (-len(real) % 4)))
    forged = base64.urlsafe_b64encode(json.dumps([signature, value, last]).encode()).decode().rstrip("=")
    answer = api.get("/projects", {**query, "cursor": forged})
    if answer.status != 200:
        answer.refused(422, "invalid_cursor")
    assert api.get("/projects", {**query, "cursor": real}).ok()["items"][0]["name"] == f"1 {tail}"


def test_too_large_and_non_json_bodies_are_refused(api: Api) -> None:
    problem = api.post("/projects", b" " * (4 * 1024 * 1024 + 1)).refused(413, "body_too_large")
    assert problem["limit_bytes"] == 4 * 1024 * 1024
    api.post("/projects", b"{").refused(422, "invalid_request")
    api.post("/projects", b"\xff").refused(422, "invalid_request")
    api.post("/projects", b"[" * 100_000).refused(422, "invalid_request")
