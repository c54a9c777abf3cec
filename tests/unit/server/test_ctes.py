"""Every common table expression has a readable name."""

import ast
from pathlib import Path

import kleinkram.server

_SERVER = Path(kleinkram.server.__file__).parent


def test_every_cte_has_a_name_of_ours() -> None:
    # Without one, SQLAlchemy names it after its address in memory. `prefix_with` returns a copy of that name, and the
    # address is free: the next one may be given the same, and their statement is refused for as long as it is kept.
    calls = [
        (path, node)
        for path in _SERVER.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "cte"
    ]
    assert len(calls) > 10
    unnamed = [f"{path}:{node.lineno}" for path, node in calls if not node.args]
    assert not unnamed
