"""Untrusted YAML yields plain values or the place of the error."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml.scanner import Scanner

from kleinkram.contract.errors import YamlInvalid
from kleinkram.contract.metadata import MAX_DEPTH, MAX_VALUES
from kleinkram.untrusted_yaml import TextPosition, read_yaml

# fmt: off
_PIECES = [
    "a", "b: ", "- ", "\n", "  ", "\t", "[", "]", "{", "}", ",", "? ", ": ", '"', "'", "\\x", "\\U9999", "&x ", "*x ",
    "!t ", "!<x>", "%YAML 1.2\n", "%TAG ! x\n", "---\n", "...\n", "#c\n", "|\n", ">+\n", "1e5", ".inf", "0x", "~",
    "\r", "\u2028", "\x85", "\ufeff", "<<: ", "é", "%ff", "\\\n", ">9", "\x00",
]
# fmt: on
_LINE_ENDS = "\n\r\x85\u2028"


def _refusal(text: str) -> YamlInvalid | None:
    try:
        read_yaml(text)
    except YamlInvalid as error:
        return error
    return None


@given(st.lists(st.sampled_from(_PIECES), max_size=16).map("".join))
def test_any_text_is_read_or_refused_with_a_place(text: str) -> None:
    refusal = _refusal(text)
    if refusal is not None:
        assert 1 <= refusal.line <= sum(text.count(end) for end in _LINE_ENDS) + 1
        assert refusal.column >= 1
        assert refusal.reason


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None),
        ("# nothing\n", None),
        ("yes", "yes"),
        ("True", True),
        ("~", None),
        ("2024-05-31", "2024-05-31"),
        ("0o17", 15),
        ("0x1F", 31),
        ("-7", -7),
        ("1.", 1.0),
        (".5e1", 5.0),
        ("1_000", "1_000"),
        ("12:30", "12:30"),
        ("'7'", "7"),
        ("|\n  two\n  lines\n", "two\nlines\n"),
        ("-.inf", -math.inf),
        ("[a, {b: c}]", ["a", {"b": "c"}]),
        ("%YAML 1.1\n---\nyes\n", "yes"),
        ("9223372036854775807", 2**63 - 1),
    ],
)
def test_scalars_follow_the_core_schema(text: str, value: object) -> None:
    assert read_yaml(text).value == value


def test_values_of_yaml_have_positions() -> None:
    document = read_yaml("a: 1\nb:\n  - x\n  - c: 2\n")
    assert document.position(("b", 1, "c")) == TextPosition(4, 5)
    assert document.position(("b", 1, "absent")) == TextPosition(4, 5)
    assert document.position(("b", 1)) == TextPosition(4, 5)
    assert document.position(("absent",)) is None


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "{a: " * 40_000,
        "- " * 90_000,
        "[" + "a," * 99_000,
        "&a [*a]",
        "? " * 90_000,
        f"{'k' * 201}: 1",
        '"\\U99999999"',
        "- " * 5 + "x\n" + "- y\n" * MAX_VALUES,
    ],
    ids=["brackets", "braces", "dashes", "items", "alias", "keys", "long key", "escape", "nodes"],
)
def test_unbounded_yaml_expansion_is_aborted(text: str) -> None:
    with pytest.raises(YamlInvalid):
        read_yaml(text)


@pytest.mark.parametrize("opening", ["[", "{", "{a: ", "[{a: ", "- ", "? ", "a: [", "- {b: "])
def test_deep_nesting_is_refused_early(opening: str, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[None] = []
    fetch_more_tokens = Scanner.fetch_more_tokens

    def count_calls(scanner: Scanner) -> None:
        calls.append(None)
        fetch_more_tokens(scanner)

    monkeypatch.setattr(Scanner, "fetch_more_tokens", count_calls)
    assert _refusal(opening * 10_000) is not None
    assert len(calls) < 8 * MAX_DEPTH


@pytest.mark.parametrize(("text", "column"), [("[" * 1000, 22), ("a: " + "[" * 1000, 24), ("- " * 1000, 43)])
def test_nesting_is_refused_where_it_goes_too_deep(text: str, column: int) -> None:
    refusal = _refusal(text)
    assert refusal is not None
    assert (refusal.line, refusal.column) == (1, column)
    assert f"more than {MAX_DEPTH} levels" in refusal.reason
