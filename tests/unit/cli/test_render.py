"""Rendering of text for terminals."""

import io

import pytest
import typer

from kleinkram.cli.cut import watch_shares
from kleinkram.cli.errors import Interrupted
from kleinkram.cli.render import Output, details, escape, line, note, show_json, table
from kleinkram.client.transfer import Outcome


@pytest.mark.parametrize(
    ("hostile", "shown"),
    [
        ("\x1b[31mred\x07", "\\x1b[31mred\\x07"),
        ("two\nlines\r", "two\\x0alines\\x0d"),
        ("abc\u202egnp.exe", "abc\\u202egnp.exe"),
        ("\x9b2J", "\\x9b2J"),
        ("zero\u200bwidth", "zero\\u200bwidth"),
        ("\udcff", "\\udcff"),
        ("grüße 🤖 文", "grüße 🤖 文"),
    ],
)
def test_terminal_control_sequences_are_escaped(hostile: str, shown: str) -> None:
    assert escape(hostile) == shown


def test_output_is_escaped_once(capsys: pytest.CaptureFixture[str]) -> None:
    line("a\x1b]52;c;eA==\x07")
    note("Moved " + escape("b\u202e") + " and c\r")
    output = capsys.readouterr()
    assert (output.out, output.err) == ("a\\x1b]52;c;eA==\\x07\n", "Moved b\\u202e and c\\x0d\n")


def test_columns_are_aligned_and_numbers_are_at_the_right(capsys: pytest.CaptureFixture[str]) -> None:
    table(["name", "count"], [("a", 5), ("文字\x1b", 12345), ("none", None)])
    assert capsys.readouterr().out.splitlines() == [
        "NAME      COUNT",
        "a             5",
        "文字\\x1b  12345",
        "none          -",
    ]


def test_an_empty_table_prints_a_note_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    table(["name"], [])
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err


def test_details_omit_missing_values(capsys: pytest.CaptureFixture[str]) -> None:
    details([("name", "x"), ("nothing", None), ("empty", ""), ("count", 0), ("long name", True)])
    assert capsys.readouterr().out.splitlines() == ["name:      x", "count:     0", "long name: yes"]


def test_json_has_plain_values(capsys: pytest.CaptureFixture[str]) -> None:
    show_json({"outcome": Outcome.already_present, "items": [{"a": 1}], "name": "\x1b"})
    assert capsys.readouterr().out == (
        '{\n  "outcome": "already_present",\n  "items": [\n    {\n      "a": 1\n    }\n  ],\n  "name": "\\u001b"\n}\n'
    )


def test_output_is_a_document_or_text_and_sets_the_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    output = Output({"moved": 1}, ["Moved one file.", "It was large."], exit_code=9)
    with pytest.raises(typer.Exit) as ended:
        output.show(as_json=False)
    assert ended.value.exit_code == 9
    assert capsys.readouterr() == ("", "Moved one file.\nIt was large.\n")
    with pytest.raises(typer.Exit):
        output.show(as_json=True)
    assert capsys.readouterr() == ('{\n  "moved": 1\n}\n', "")
    Output({}, lambda: line("a table")).show(as_json=False)
    assert capsys.readouterr().out == "a table\n"


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_bars_have_any_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one with brackets, which are markup elsewhere, and with control characters."""
    terminal = _Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with watch_shares() as watch:
        show = watch("a[/b].\x1bmcap")
        assert show is not None
        show(0.5)
    assert "a[/b].\\x1bmcap" in terminal.getvalue()
    with pytest.raises(Interrupted), watch_shares():
        raise KeyboardInterrupt
