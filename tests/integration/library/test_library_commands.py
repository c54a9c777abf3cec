"""`klein action library|add`, and `kleinkram/NAME` where a command takes a path; `client.actions.add_from_library`."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

import kleinkram
from kleinkram.cli.main import app
from kleinkram.client import connect
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.errors import NotFound, NotFromLibrary
from kleinkram.contract.library import LibraryState
from kleinkram.contract.locks import parse_lock
from kleinkram.library import shipped_actions
from tests.integration import people
from tests.integration.api_server import Api
from tests.package_index import PackageIndex

NAME = "kleinkram/slam-evaluate"
SCRIPT = shipped_actions()["slam-evaluate"].script or ""
Klein = Callable[..., Result]


@pytest.fixture(name="klein")
def _klein(lab: Api, monkeypatch: pytest.MonkeyPatch) -> Klein:
    """A terminal: runs `klein action …`, and raises what the command raises."""
    monkeypatch.setenv("KLEINKRAM_URL", lab.url)
    monkeypatch.setenv("KLEINKRAM_TOKEN", str(lab.token))

    def run(*arguments: str) -> Result:
        ran = CliRunner().invoke(app, ["action", *arguments])
        if ran.exception is not None:
            raise ran.exception
        return ran

    return run


@pytest.fixture(name="project")
def _project(lab: Api) -> str:
    return str(lab.project()["name"])


def state(klein: Klein, project: str) -> str:
    items = json.loads(klein("library", "-p", project, "--json").stdout)["items"]
    return str({item["name"]: item["state"] for item in items}[NAME])


def test_an_action_is_listed_and_added(klein: Klein, project: str) -> None:
    lines = klein("library", "-p", project).stdout.splitlines()
    assert [line.split()[0] for line in lines[1:]] == [f"kleinkram/{name}" for name in shipped_actions()]
    assert all("not added" in line for line in lines[1:])
    ran = klein("add", NAME, "-p", project)
    assert f"Published {NAME} in the project {project} as slam-evaluate@1." in ran.stderr
    assert f"klein project actions add slam-evaluate -p {project}" in ran.stderr
    assert "added as version 1" in klein("library", "-p", project).stdout
    shown = klein("info", "slam-evaluate", "-p", project).stdout
    assert f"{NAME}@{kleinkram.__version__}" in shown
    assert NAME in klein("list", "-p", project).stdout


def test_adding_again_says_that_nothing_was_published(klein: Klein, project: str) -> None:
    klein("add", "slam-evaluate", "-p", project)
    ran = klein("add", NAME, "-p", project)
    assert f"slam-evaluate@1 in the project {project} is {NAME} as it is shipped; nothing was published." in ran.stderr


def test_without_a_project_it_is_added_for_the_whole_lab(klein: Klein, project: str) -> None:
    assert "for the whole lab" in klein("add", NAME).stderr
    assert "added as version 1" in klein("library").stdout
    assert state(klein, project) == "available"


@pytest.mark.parametrize("command", [("add",), ("library", "--show"), ("lock",), ("run-local",)])
@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("kleinkram/slam-evalute", "the closest is kleinkram/slam-evaluate."),
        ("kleinkram/cook", "it has kleinkram/"),
    ],
)
def test_a_mistyped_name_is_answered_with_the_closest_or_all(
    klein: Klein, command: tuple[str, ...], name: str, hint: str
) -> None:
    with pytest.raises(InvalidInput) as refusal:
        klein(*command, name)
    assert hint in str(refusal.value)


def test_the_script_is_shown_as_a_file_without_a_server(
    klein: Klein, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("KLEINKRAM_URL")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    for name in (NAME, "slam-evaluate"):
        assert klein("library", "--show", name).stdout == SCRIPT


def test_a_shipped_script_is_locked_by_its_name(
    klein: Klein, index: PackageIndex, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = klein("lock", NAME, "--package-index", index.url)
    assert [(package.name, package.version) for package in parse_lock(ran.stdout)] == [("evo", "1.38.1")]
    (tmp_path / "kleinkram").mkdir()
    (tmp_path / NAME).write_text("print('mine')")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInput, match="it is not a mapping of names to values"):
        klein("lock", NAME, "--package-index", index.url)


def test_the_sdk_lists_and_adds(lab: Api, project: str) -> None:
    with connect(lab.url, token=lab.token) as client:
        assert {item.state for item in client.actions.library(project=project)} == {LibraryState.available}
        made = client.actions.add_from_library(NAME, project=project)
        assert client.actions.add_from_library("slam-evaluate", project=project) == made
        client.actions.add_version(made, made.latest.definition.model_copy(update={"description": "mine"}))
        with pytest.raises(NotFromLibrary):
            client.actions.add_from_library(NAME, project=project)
        with pytest.raises(NotFound, match="kleinkram/a b"):
            client.actions.add_from_library("a b", project=project)
    stranger = people.token(lab, people.person(lab)).secret
    with connect(lab.url, token=stranger) as client, pytest.raises(NotFound):
        client.actions.library(project=project)
