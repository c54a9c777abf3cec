"""Texts for people (pages, help, errors, the web interface) contain no phrases of the project's early drafts."""

import inspect
import re
from pathlib import Path

import pytest

from kleinkram.client import errors as client_errors
from kleinkram.contract import errors

ROOT = Path(__file__).parents[3]
# migrating.md lists old words; reference/cli.md is the help of all commands.
_PAGES = {*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")} - {ROOT / "docs" / "migrating.md"}
_TEXTS = (ROOT / "web" / "src" / "texts").glob("*.ts")
_LITERAL = re.compile(r'"(?:[^"\\\n]|\\.)*"|`(?:[^`\\]|\\.)*`')

BANNED = (
    r"the very same",
    r"whoever",
    r"doom(ed|s|ing)?",
    r"twins?",
    r"proven",
    r"lets? go( of)?",
    r"(is|are|was|were) told",
    r"what (you|one|they|it) came with",
    r"drawn by lot",
    r"at home",
    r"keeps? in mind",
    r"what one may not",
    r"what is odd",
    r"odd things",
    r"oddit(y|ies)",
    r"nobody's concern",
    r"in vain",
    r"takes you for",
    r"had back",
    r"wardens?",
    r"mend(s|ed)?",
    r"claim code",
    r"on its way back",
)
"""Phrases of the project's early drafts; docs/migrating.md lists what replaced them."""
_BANNED = re.compile(rf"(?<![\w-])(?:{'|'.join(BANNED)})(?![\w-])".replace(" ", r"\s+"), re.IGNORECASE)


@pytest.mark.parametrize("page", sorted(_PAGES), ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_contains_no_banned_phrase(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not [f"line {text.count(chr(10), 0, match.start()) + 1}: {match[0]}" for match in _BANNED.finditer(text)]


@pytest.mark.parametrize("module", sorted(_TEXTS), ids=lambda module: module.name)
def test_a_text_of_the_web_interface_contains_no_banned_phrase(module: Path) -> None:
    literals = [text for text in _LITERAL.findall(module.read_text(encoding="utf-8")) if " " in text]
    assert literals
    assert not [text for text in literals if _BANNED.search(text)]


def test_no_error_contains_a_banned_phrase() -> None:
    classes = [*inspect.getmembers(errors, inspect.isclass), *inspect.getmembers(client_errors, inspect.isclass)]
    sentences = {name: inspect.getdoc(error) or "" for name, error in classes}
    assert len(sentences) > 50
    assert not {name: match[0] for name, text in sentences.items() if (match := _BANNED.search(text))}


@pytest.mark.parametrize("phrase", ["what you came with", "It is doomed.", "Whoever asks", "the very same run"])
def test_a_banned_phrase_is_found(phrase: str) -> None:
    assert _BANNED.search(phrase)


@pytest.mark.parametrize("text", ["a household name", "improvement", "let the server go offline", "the retold story"])
def test_similar_words_are_allowed(text: str) -> None:
    assert not _BANNED.search(text)
