"""Untrusted log lines cannot control the terminal."""

import pytest

from kleinkram.cli.run_view import harmless


@pytest.mark.parametrize(
    ("written", "shown"),
    [
        ("plain\tand tabs\nnext\n", "plain\tand tabs\nnext\n"),
        ("\x1b[1;31mred\x1b[0m word", "\x1b[1;31mred\x1b[0m word\x1b[0m"),
        ("\x1b]0;title\x07", "\\x1b]0;title\\x07"),
        ("\x1b[2Jgone", "\\x1b[2Jgone"),
        ("10 %\r50 %\r100 %\ndone", "100 %\ndone"),
        ("windows\r\n", "windows\n"),
        ("left\u202eto right", "left\\u202eto right"),
    ],
)
def test_log_lines_keep_only_colour_codes(written: str, shown: str) -> None:
    assert harmless(written) == shown
