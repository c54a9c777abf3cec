"""Commands, options, links and paths on the pages exist."""

import importlib
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

from kleinkram.cli.main import app

ROOT = Path(__file__).parents[3]
# migrating.md lists commands of the original beside ours.
PAGES = sorted({*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")} - {ROOT / "docs" / "migrating.md"})
_ENDS = {"|", ">", ">>", "<", "&", "&&", "||", ";"}
_NAME = re.compile(r"[a-z][a-z-]*")
_PATH = re.compile(r"`((?:src|tests|docs|web|deploy|examples|benchmarks|tools)/[\w./-]+)`")


def commands_on(page: Path) -> Iterator[str]:
    """Yield each command line that begins with klein, in blocks of code and between backticks."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = re.findall(r"```(?:bash|console)\n(.*?)```", text, re.DOTALL)
    for line in "\n".join(blocks).splitlines():
        stripped = line.strip().removeprefix("$ ")
        if stripped.startswith("klein "):
            yield stripped
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    yield from (span for span in re.findall(r"`([^`\n]+)`", prose) if span.startswith("klein "))


@cache
def root() -> Any:  # Any: Typer may use its own copy of click
    return typer.main.get_command(app)


def resolve(words: list[str]) -> tuple[Any, list[str]]:
    """Return the command that words name, and the words after it."""
    command, context = root(), None
    path: list[str] = []
    while hasattr(command, "get_command") and words and _NAME.fullmatch(words[0]):
        context = command.context_class(command, parent=context)
        subcommand = command.get_command(context, words[0])
        assert subcommand is not None, f"there is no `klein {' '.join([*path, words[0]])}`"
        path.append(words[0])
        command, words = subcommand, words[1:]
    return command, words


def options_of(command: Any) -> set[str]:
    own = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    return own | {"--help", "-h", "--version"}


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_commands_on_pages_exist(page: Path) -> None:
    for line in commands_on(page):
        words = shlex.split(line, comments=True)[1:]
        stop = next((number for number, word in enumerate(words) if word in _ENDS), len(words))
        command, rest = resolve(words[:stop])
        options = {
            word.partition("=")[0] for word in rest if word.startswith("-") and len(word) > 1 and not word[1:].isdigit()
        }
        unknown = options - options_of(command)
        assert not unknown, f"`{line}`: {command.name} has no {', '.join(sorted(unknown))}"


def test_pages_show_commands() -> None:
    assert sum(len([*commands_on(page)]) for page in PAGES) > 50


def headings_of(page: Path) -> set[str]:
    """Return the names by which a page's headings are linked to."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_links_on_pages_exist(page: Path) -> None:
    prose = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", prose):
        if "://" in link:
            continue
        path, _, heading = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), f"{link} does not exist"
        assert not heading or heading in headings_of(target), f"{link} has no such heading"


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_paths_on_pages_exist(page: Path) -> None:
    if page.name != "CHANGELOG.md":
        paths = _PATH.findall(page.read_text(encoding="utf-8"))
        assert not [path for path in paths if "FEATURE" not in path and not (ROOT / path).exists()]


def test_the_reading_paths_exist_and_are_short() -> None:
    section = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").partition("## Four reading paths")[2]
    reading_paths = section.partition("\n## ")[0].split("\n**")[1:]
    files = [re.findall(r"`([\w/]+/[\w/]+\.py)`", reading_path) for reading_path in reading_paths]
    assert [len(paths) for paths in files] == [10] * 4
    assert not [path for paths in files for path in paths if not (ROOT / "src" / "kleinkram" / path).is_file()]


def test_the_files_that_extensions_change_exist() -> None:
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    paths = re.findall(r"`((?:recordings|runner|contract|server|client|cli)/[\w./]+)`", page)
    assert len(paths) >= 20
    assert not [path for path in paths if not (ROOT / "src" / "kleinkram" / path).exists()]


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_python_names_on_pages_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    names = set(re.findall(r"`(kleinkram(?:\.\w+)+)", text))
    for module, imported in re.findall(r"^from (kleinkram[\w.]*) import (.+)$", text, re.MULTILINE):
        names |= {f"{module}.{name.strip()}" for name in imported.split(",")}
    for name in names:
        module, _, attribute = name.rpartition(".")
        try:
            importlib.import_module(name)
        except ModuleNotFoundError:
            assert hasattr(importlib.import_module(module), attribute), name
