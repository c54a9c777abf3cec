"""Scripts are locked when they are published or first run, or refused in a sentence, and then nothing is left."""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Iterator
from typing import Any

import pytest

from kleinkram import connect
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.locks import parse_lock
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.runs.conftest import FakeRunner
from tests.integration.upload_client import upload
from tests.package_index import PackageIndex, serve_index


@pytest.fixture(scope="module")
def shared_index(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PackageIndex]:
    """An index for all tests of this module, without the proxies of this machine."""
    before = os.environ.get("NO_PROXY")
    os.environ["NO_PROXY"] = "127.0.0.1"
    with serve_index(tmp_path_factory.mktemp("wheels")) as made:
        made.add("arm", "1.0")
        made.add("robot", "1.0", requires=["arm"])
        yield made
    del os.environ["NO_PROXY"]
    if before is not None:
        os.environ["NO_PROXY"] = before


@pytest.fixture(scope="module")
def lab(start_api: StartApi, shared_index: PackageIndex) -> Api:
    """An API that locks from the index."""
    return start_api(package_index=shared_index.url)


@pytest.fixture
def mission(lab: Api) -> Any:
    made = lab.mission(lab.project()["id"])
    upload(lab, made["id"], "drive.bin", uuid.uuid4().bytes)
    return made


@pytest.fixture
def runner(lab: Api) -> FakeRunner:
    admin = people.person(lab, admin=True)
    made = FakeRunner(lab.as_(people.token(lab, admin, [Scope.run], kind=TokenKind.runner).secret))
    made.register(environments=True)
    return made


def definition(*dependencies: str, **values: Any) -> dict[str, Any]:
    name = f"action-{uuid.uuid4().hex[:8]}"
    return {"name": name, "script": f"print({name!r})\n", "dependencies": [*dependencies], **values}


def pins(read: Any) -> set[str]:
    return {f"{package.name}=={package.version}" for package in parse_lock(read["lock"])}


def publish(lab: Api, *dependencies: str, status: int = 201, **values: Any) -> Any:
    project_id = lab.project()["id"]
    answer = lab.post("/actions", {"project_id": project_id, "definition": definition(*dependencies, **values)})
    return answer.ok(201) if status == 201 else answer.refused(status, "invalid_request")


def test_a_published_script_is_locked(lab: Api) -> None:
    made = publish(lab, "robot>=1", "open-kleinkram")
    assert pins(made["latest"]["definition"]) == {"robot==1.0", "arm==1.0"}
    assert publish(lab, "open-kleinkram")["latest"]["definition"]["lock"] is None


@pytest.mark.parametrize(
    ("dependency", "message"),
    [
        ("gripper", "There is no package gripper in the package index."),
        ("arm>=3", "There is no release arm>=3 in the package index."),
        ("arm @ https://example.org/arm.whl", "packages come from the package index"),
        ("arm\n-r /etc/hostname", "is not a requirement"),
        (r"""arm; platform_version == 'x"\n-r /etc/hostname\narm; platform_version == "x'""", "is not a requirement"),
    ],
)
def test_what_cannot_be_locked_is_refused_and_not_stored(lab: Api, dependency: str, message: str) -> None:
    project_id = lab.project()["id"]
    requested = {"project_id": project_id, "definition": definition(dependency)}
    problem = lab.post("/actions", requested).refused(422, "invalid_request")
    assert problem["problems"][0]["field"] == "definition.dependencies"
    assert message in problem["problems"][0]["message"]
    assert lab.get("/actions", {"project_id": project_id}).ok()["items"] == []


def test_an_index_that_is_away_is_named(lab: Api, shared_index: PackageIndex) -> None:
    shared_index.status = 500
    try:
        problem = publish(lab, "arm", status=422)
    finally:
        shared_index.status = 200
    assert "The package index does not answer" in problem["problems"][0]["message"]


def test_an_own_lock_is_stored_if_it_contains_the_dependencies(lab: Api) -> None:
    lock = f"arm==1.0 \\\n    --hash=sha256:{'a' * 64}\n"
    assert publish(lab, "arm", lock=lock)["latest"]["definition"]["lock"] == lock
    for dependency, wrong, message in (
        ("robot", lock, "robot is not locked"),
        ("arm>=2", lock, "arm>=2 is locked as arm==1.0"),
        ("arm", "arm==1.0\n", "must be followed by hashes"),
        ("arm", lock + "--index-url https://example.org\n", "is not a requirement"),
        ("pydantic", lock.replace("arm==1.0", "pydantic==1.0"), "kleinkram.action needs pydantic"),
    ):
        problem = publish(lab, dependency, lock=wrong, status=422)
        assert message in problem["problems"][0]["message"], message


def test_only_those_who_may_publish_have_a_lock_made(lab: Api, shared_index: PackageIndex) -> None:
    project_id = lab.project()["id"]
    stranger = lab.as_(people.token(lab, people.person(lab)).secret)
    shared_index.requests.clear()
    stranger.post("/actions", {"project_id": project_id, "definition": definition("arm")}).refused(404, "not_found")
    assert shared_index.requests == []


def test_an_unchanged_definition_keeps_its_lock(lab: Api, shared_index: PackageIndex) -> None:
    made = publish(lab, "robot")
    path = f"/actions/{made['id']}/versions"
    requested = made["latest"]["definition"] | {"lock": None}
    shared_index.requests.clear()
    same = lab.post(path, {"definition": requested}).ok(201)
    assert (same["latest"]["number"], shared_index.requests) == (1, [])
    changed = lab.post(path, {"definition": requested | {"dependencies": ["arm"]}}).ok(201)
    assert (changed["latest"]["number"], pins(changed["latest"]["definition"])) == (2, {"arm==1.0"})


def test_an_unpublished_script_is_locked_once(
    lab: Api, mission: Any, runner: FakeRunner, shared_index: PackageIndex
) -> None:
    requested = {"mission_ids": [mission["id"]], "force": True}
    requested["definition"] = definition("robot", resources={"labels": runner.labels})
    (first,) = lab.post("/runs", requested).ok()["items"]
    shared_index.requests.clear()
    (second,) = lab.post("/runs", requested).ok()["items"]
    assert shared_index.requests == []
    definitions = [lab.get(f"/runs/{item['run']['id']}").ok()["definition"] for item in (first, second)]
    assert definitions[0] == definitions[1]
    claim = runner.claim()
    assert pins(claim) == {"robot==1.0", "arm==1.0"}

    requested["definition"] = definition("gripper", resources={"labels": runner.labels})
    problem = lab.post("/runs", requested).refused(422, "invalid_request")
    assert problem["problems"][0]["message"] == "There is no package gripper in the package index."


def test_runners_that_install_nothing_do_not_get_it(lab: Api, mission: Any, runner: FakeRunner) -> None:
    requested = {"mission_ids": [mission["id"]], "force": True}
    requested["definition"] = definition("arm", resources={"labels": runner.labels})
    (item,) = lab.post("/runs", requested).ok()["items"]
    runner.register(environments=False)
    assert runner.claim() is None
    waiting = lab.get(f"/runs/{item['run']['id']}").ok()["waits_for"]
    assert "it installs no packages, and the script has dependencies" in waiting
    (refused,) = lab.post("/runs", requested).ok()["items"]
    assert refused["problem"]["code"] == "no_runner"
    assert "it installs no packages, and the script has dependencies" in refused["problem"]["detail"]
    runner.register(environments=True)
    assert runner.claim()["run_id"] == item["run"]["id"]


def test_progress_of_the_preparation_ends_with_it(lab: Api, mission: Any, runner: FakeRunner) -> None:
    requested = {"mission_ids": [mission["id"]], "force": True}
    requested["definition"] = definition("arm", resources={"labels": runner.labels})
    (item,) = lab.post("/runs", requested).ok()["items"]
    claim = runner.claim()
    runner.heartbeat(claim, "preparing", progress={"fraction": 0.5, "message": "Installing 1 package"})
    read = lab.get(f"/runs/{item['run']['id']}").ok()
    assert (read["state"], read["progress"]["message"]) == ("preparing", "Installing 1 package")
    runner.heartbeat(claim, "running")
    assert lab.get(f"/runs/{item['run']['id']}").ok()["progress"] is None


def test_the_python_that_a_script_requires_counts(lab: Api, shared_index: PackageIndex) -> None:
    shared_index.add("modern", "1.0", requires_python=">=3.12")
    problem = publish(lab, "modern", status=422)
    assert 'requires-python = ">=3.12"' in problem["problems"][0]["message"]
    assert pins(publish(lab, "modern", requires_python=">=3.12")["latest"]["definition"]) == {"modern==1.0"}


def test_without_an_index_dependencies_are_the_image_s(start_api: StartApi) -> None:
    off = start_api(package_index="off")
    assert publish(off, "no-such-package")["latest"]["definition"]["lock"] is None


def test_lists_name_the_locked_versions_but_leave_out_the_lock(lab: Api, mission: Any, runner: FakeRunner) -> None:
    """A lock is large: that of evo has 100 kB."""
    lock = "".join(f"arm{number}==1.0 \\\n    --hash=sha256:{'a' * 64}\n" for number in range(1000))
    dependencies = [f"arm{number}" for number in range(3)]
    requested = definition(*dependencies, lock=lock) | {"resources": {"labels": runner.labels}}
    project_id = mission["project"]["id"]
    made = lab.post("/actions", {"project_id": project_id, "definition": requested}).ok(201)
    for number in range(2, 7):
        changed = {"definition": requested | {"description": f"version {number}"}}
        lab.post(f"/actions/{made['id']}/versions", changed).ok(201)
    launched = lab.post("/runs", {"mission_ids": [mission["id"]], "action_id": made["id"], "version": 2}).ok()
    run_id = launched["items"][0]["run"]["id"]

    versions = lab.get(f"/actions/{made['id']}/versions").ok()
    (listed,) = lab.get("/actions", {"project_id": project_id, "name": requested["name"]}).ok()["items"]
    detail = lab.get(f"/runs/{run_id}").ok()
    for row in (*versions["items"], listed["latest"], detail):
        assert (row["definition"]["lock"], len(row["packages"]), row["packages"][0]) == (None, 1000, "arm0==1.0")
        assert row["definition"]["script"] == requested["script"]
    assert max(len(json.dumps(row)) for row in (*versions["items"], listed, detail)) < len(lock) / 4

    one = lab.get(f"/actions/{made['id']}/versions/2").ok()
    assert (one["number"], one["definition"]["lock"], one["packages"]) == (2, lock, detail["packages"])
    assert lab.get(f"/actions/{made['id']}").ok()["latest"]["definition"]["lock"] == lock
    lab.get(f"/actions/{made['id']}/versions/99").refused(404, "not_found")
    assert lab.post(f"/runs/{run_id}/retry").ok(201)["action"]["version"] == 2
    with connect(lab.url, token=lab.token) as client:
        action = client.actions.get(requested["name"], project=project_id)
        assert client.actions.version(action, 6).definition.lock == lock
        same = client.actions.add_version(action.id, client.actions.version(action, 6).definition)
        assert same.latest.number == 6
