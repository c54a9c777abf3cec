"""The example of docs/access.md runs and has the documented results."""

import datetime
import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from .browser import Browser, log_in
from .conftest import Terminal, terminal_away

PAGE = Path(__file__).parents[2] / "docs" / "access.md"


@pytest.fixture
def people(terminal: Terminal, tmp_path: Path, browser: Browser) -> Iterator[dict[str, Terminal]]:
    """Run the commands of the example, and return the terminals of its people."""
    people = {}
    for email in ("ben@lab.example", "chloe@partner.example"):
        name = email.partition("@")[0]
        link = terminal.run("person", "invite", email, "--name", name).out
        people[name] = terminal_away(tmp_path / name)
        log_in(people[name], browser.accept_invitation(link))
    (tmp_path / "a.bin").write_bytes(b"bytes")
    terminal.run("project", "create", "alpine")
    terminal.run("upload", "-p", "alpine", "-m", "jungfraujoch-1", "--create", tmp_path / "a.bin")
    printed = [terminal.run(*command).out for command in example()]
    secret = next(out.split()[-1] for out in printed if "klein_robot_" in out)
    link = next(word for out in printed for word in out.split() if "#klein_link_" in word)
    for name, known in {"robot": {"URL": browser.url, "TOKEN": secret}, "link": {"URL": link}}.items():
        away = terminal_away(tmp_path / name)
        environment = {f"KLEINKRAM_{key}": value for key, value in known.items()}
        people[name] = replace(away, environment={**away.environment, **environment})
    yield {"ada": terminal, **people}
    terminal.run("project", "delete", "alpine", "--yes")


def example() -> Iterator[list[str]]:
    """Yield the commands of the example, with dates in the future."""
    block = PAGE.read_text().partition("## An example")[2].partition("```bash")[2].partition("```")[0]
    later = (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=60)).date()
    for line in re.sub(r"20\d\d-\d\d-\d\d", str(later), block).splitlines():
        if line.startswith("klein "):
            yield shlex.split(line, comments=True)[1:]


def names(terminal: Terminal, *command: str) -> set[str]:
    return {row["name"] for row in terminal.run(*command, "--json").json()["items"]}


@pytest.mark.slow  # fifty commands
def test_the_people_of_the_example_have_the_documented_rights(people: dict[str, Terminal], tmp_path: Path) -> None:
    projects = {name: names(it, "project", "list") for name, it in people.items()}
    missions = {name: names(it, "mission", "list") for name, it in people.items()}
    assert "alpine" in projects.pop("ada")
    assert projects == {"ben": {"alpine"}, "chloe": set(), "robot": {"alpine"}, "link": set()}
    assert "jungfraujoch-1" in missions.pop("ada")
    assert missions == {name: {"jungfraujoch-1"} for name in ("ben", "chloe", "robot", "link")}

    (tmp_path / "b.bin").write_bytes(b"more")
    ran = {
        name: (
            it.run(
                "download", "-p", "alpine", "-m", "jungfraujoch-1", "--dest", tmp_path / f"to-{name}", code=None
            ).code,
            it.run("upload", "-p", "alpine", "-m", f"ridge-{name}", "--create", tmp_path / "b.bin", code=None).code,
            it.run("mission", "delete", "jungfraujoch-1", "-p", "alpine", "--yes", code=None).code,
        )
        for name, it in people.items()
        if name != "ada"
    }
    assert ran == {"ben": (0, 0, 4), "chloe": (0, 3, 4), "robot": (4, 0, 4), "link": (0, 3, 4)}
    people["ada"].run("mission", "delete", "jungfraujoch-1", "-p", "alpine", "--yes")
