"""The pages on recordings name every problem code, and their examples run."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_mcap

ROOT = Path(__file__).parents[3]


def test_every_problem_code_is_on_the_page() -> None:
    page = (ROOT / "docs/formats.md").read_text()
    table = page.split("<!-- codes -->")[1].split("<!-- /codes -->")[0]
    listed = re.findall(r"^\| `([a-z-]+)` \|", table, re.MULTILINE)
    assert listed == sorted(set(listed))
    assert set(listed) == set(codes_in_source())


def codes_in_source() -> Iterator[str]:
    """Yield the first argument of whatever makes a problem, anywhere in the source."""
    for path in (ROOT / "src/kleinkram").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and _makes_a_problem(node) and isinstance(node.args[0], ast.Constant):
                yield str(node.args[0].value)


def _makes_a_problem(call: ast.Call) -> bool:
    if not call.args:
        return False
    name = ast.unparse(call.func)
    if name == "NotIndexed":  # only some of these reach a person
        return any(word.arg == "is_problem" and ast.literal_eval(word.value) for word in call.keywords)
    return name == "Problem" or (name.endswith("problem_log.add") and len(call.args) == 3)


def test_the_reading_guide_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    generate_mcap(tmp_path / "drive.mcap", duration_s=3, size_bytes=11_000_000)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/reading.md").read_text(), re.DOTALL)
    local = [block for block in blocks if "kleinkram.connect()" not in block]
    assert len(local) == len(blocks) - 1
    shared: dict[str, object] = {}
    shown = []
    for block in local:
        exec(block, shared)
        shown.append(capsys.readouterr().out)
    assert all(shown)
    assert "no-footer cut.mcap" in shown[-1]
