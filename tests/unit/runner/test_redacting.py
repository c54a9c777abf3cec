"""Secrets are redacted from logs however the log is split, and nothing else is."""

from __future__ import annotations

import random

from kleinkram.runner.logs import Redactor

TOKEN = "klein_run_" + "t" * 43 + "abcdef"
SIGNED = b"https://store/x?X-Amz-Credential=key%2F2026&X-Amz-Signature=" + b"0123456789abcdef" * 4 + b"&"


def cleaned(redactor: Redactor, data: bytes, most_bytes: int) -> bytes:
    """Redact a log in chunks, as it is uploaded."""
    out, at = b"", 0
    while at < len(data):
        window = data[at : at + most_bytes]
        size = redactor.cut(window, most_bytes) if len(window) == most_bytes else len(window)
        out += redactor.redact(window[:size])
        at += size
    return out


def test_redacting_in_chunks_equals_redacting_at_once() -> None:
    redactor = Redactor(["a secret that only the runner knows"])
    parts = [TOKEN.encode(), SIGNED, b"a secret that only the runner knows", b"\n", b"x" * 300, b" words ", b"\r"]
    chance = random.Random(7)
    for _ in range(60):
        data = b"".join(chance.choice(parts) for _ in range(40))
        whole = redactor.redact(data)
        assert cleaned(redactor, data, 2048) == whole
        assert TOKEN[10:].encode() not in whole
        assert b"0123456789abcdef" not in whole
        assert b"only the runner" not in whole


def test_only_complete_lines_are_cut() -> None:
    redactor = Redactor([])
    assert redactor.cut(b"half a line", 100) == 0
    assert redactor.cut(b"a line\nhalf", 100) == 7


def test_other_text_is_not_redacted() -> None:
    data = b"klein_run_short klein_project X-Amz-Date=2026 \xff\xfe\n" + bytes(range(256))
    assert Redactor([TOKEN]).redact(data) == data
