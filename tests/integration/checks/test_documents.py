"""The `checks.yaml` of a project: versions, errors, rights, and changes at the same time."""

import hashlib
from concurrent.futures import ThreadPoolExecutor

import pytest

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.checks.judged import RULES, set_rules

_OTHER = RULES.replace("100 Hz", "200 Hz")


@pytest.fixture(name="project_id")
def _project_id(api: Api) -> str:
    return str(api.project()["id"])


def test_a_project_begins_without_rules(api: Api, project_id: str) -> None:
    checks = api.get(f"/projects/{project_id}/checks").ok()
    assert (checks["text"], checks["number"], checks["created_at"], checks["created_by"]) == ("", 0, None, None)
    assert checks["sha256"] == hashlib.sha256(b"").hexdigest()
    assert api.all(f"/projects/{project_id}/checks/versions") == []


def test_every_change_is_a_version_and_is_audited(api: Api, project_id: str) -> None:
    for text in (RULES, RULES, _OTHER, ""):
        set_rules(api, project_id, text).ok()
    versions = api.all(f"/projects/{project_id}/checks/versions")
    assert [(one["number"], one["is_removal"]) for one in versions] == [(3, True), (2, False), (1, False)]
    assert api.get(f"/projects/{project_id}/checks/versions/2").ok()["text"] == _OTHER
    api.get(f"/projects/{project_id}/checks/versions/4").refused(404, "not_found")
    changes = [one for one in api.events(project_id) if one["operation"] == "project.set_checks"]
    assert [(one["before"], one["after"]) for one in reversed(changes)] == [
        ({"checks": None}, {"checks": 1}),
        ({"checks": 1}, {"checks": 2}),
        ({"checks": 2}, {"checks": None}),
    ]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("version: 1\nprofiles: [", 2, "expected"),
        ("version: 1\nprofiles:\n  - topics: {/imu: {rte: 5}}\n", 3, "rte"),
        ("version: 1\nprofiles:\n  - topics:\n      /imu:\n        rate: fast\n", 5, "rate"),
        ("version: 2\nprofiles: []\n", 1, "version"),
        ("version: 1\nprofiles: &a\n  - name: x\nagain: *a\n", 2, ""),
        ("just words\n", 1, ""),
    ],
)
def test_a_faulty_file_is_refused_with_line_and_column(
    api: Api, project_id: str, text: str, line: int, words: str
) -> None:
    problem = set_rules(api, project_id, text).refused(422, "yaml_invalid")
    assert problem["line"] == line
    assert problem["column"] >= 1
    assert words in problem["reason"]
    assert api.get(f"/projects/{project_id}/checks").ok()["number"] == 0


def test_a_file_that_is_too_long_is_refused(api: Api, project_id: str) -> None:
    set_rules(api, project_id, RULES + "#" * 200_000).refused(422, "invalid_request")


def test_an_edit_of_an_outdated_file_is_refused(api: Api, project_id: str) -> None:
    etag = set_rules(api, project_id, RULES).ok()["etag"]
    set_rules(api, project_id, _OTHER, **{"If-Match": f'"{etag}"'}).ok()
    set_rules(api, project_id, "", **{"If-Match": f'"{etag}"'}).refused(412, "edit_conflict")
    assert api.get(f"/projects/{project_id}/checks").ok()["text"] == _OTHER


def test_changes_at_the_same_time_are_versions_after_each_other(api: Api, project_id: str) -> None:
    texts = [RULES.replace("100 Hz", f"{rate} Hz") for rate in range(1, 9)]
    with ThreadPoolExecutor(8) as threads:
        answers = [*threads.map(lambda text: set_rules(api, project_id, text), texts)]
    assert sorted(answer.ok()["number"] for answer in answers) == [*range(1, 9)]
    last = api.get(f"/projects/{project_id}/checks").ok()
    assert last["text"] == next(one.body["text"] for one in answers if one.body["number"] == 8)
    assert api.sql("SELECT checks_number FROM project WHERE id = %s", project_id) == [(8,)]


def test_only_with_write_rules_are_set_and_only_with_read_seen(api: Api, project_id: str) -> None:
    set_rules(api, project_id, RULES).ok()
    reader, stranger = people.person(api), people.person(api)
    people.grant(api, reader.group_id, Right.read, project_id=project_id)
    assert api.as_(reader.token).get(f"/projects/{project_id}/checks").ok()["text"] == RULES
    set_rules(api.as_(reader.token), project_id, "").refused(403, "forbidden")
    set_rules(api.as_(stranger.token), project_id, "").refused(404, "not_found")
    for path in ("", "/versions", "/versions/1", "/matrix", "/trend"):
        api.as_(stranger.token).get(f"/projects/{project_id}/checks{path}").refused(404, "not_found")
