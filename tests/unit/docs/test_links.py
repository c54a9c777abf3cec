"""Links between the pages, and the paths of code and tests that they name, exist."""

import re
from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[3]
_PAGES = [*sorted(_ROOT.glob("*.md")), *sorted((_ROOT / "docs").rglob("*.md"))]
_LINK = re.compile(r"\]\((?!https?:|mailto:|#)([^)#\s]+)(?:#[^)\s]*)?\)")
_PATH = re.compile(r"`((?:src|tests|docs|web|deploy|examples|benchmarks|tools)/[\w./-]+)`")


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: str(page.relative_to(_ROOT)))
def test_links_and_paths_in_pages_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    missing = [link for link in _LINK.findall(text) if not (page.parent / link).exists()]
    if page.name != "CHANGELOG.md":
        missing += [path for path in _PATH.findall(text) if "NOUN" not in path and not (_ROOT / path).exists()]
    assert not missing
