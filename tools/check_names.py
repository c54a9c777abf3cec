"""Check the names in the sources: `python -m tools.check_names [PATH ...]`, part of `make check`.

Fails for a class name that is defined twice in `src`, for an identifier that contains a word of `BANNED`, for a
variable whose whole name is in `VAGUE`, and for a module that is named by a participle. The words are those that this
project once used instead of the standard terms (docs/architecture.md, "Vocabulary"). Reads files only.
"""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

_ROOT = Path(__file__).parent.parent
_SOURCES = (_ROOT / "src", _ROOT / "tests", _ROOT / "benchmarks", _ROOT / "tools", _ROOT / "docs", _ROOT / "examples")

BANNED = frozenset(
    {
        "asked",
        "asker",
        "askers",
        "beat",
        "beats",
        "courtesies",
        "courtesy",
        "desk",
        "doom",
        "doomed",
        "door",
        "doors",
        "edition",
        "editions",
        "few",
        "given",
        "hear",
        "heard",
        "hears",
        "held",
        "hold",
        "journey",
        "journeys",
        "keeping",
        "kept",
        "knock",
        "knocked",
        "knocks",
        "knows",
        "lapse",
        "lapsed",
        "lapses",
        "leaving",
        "ledger",
        "looked",
        "lots",
        "mend",
        "mended",
        "mends",
        "obey",
        "obeyed",
        "obeys",
        "odd",
        "oddities",
        "oddity",
        "prove",
        "proven",
        "proves",
        "proving",
        "said",
        "shelf",
        "speak",
        "speaks",
        "sweep",
        "sweeping",
        "sweeps",
        "swept",
        "tally",
        "tell",
        "telling",
        "tells",
        "told",
        "twin",
        "twins",
        "wants",
        "ward",
        "warden",
        "wardens",
        "whoever",
        "whom",
    }
)
"""Words that no identifier may contain."""

VAGUE = frozenset({"each", "found", "ground", "stuff", "these", "thing", "things", "those", "wanted", "whom"})
"""Names that say nothing about the value."""

ALLOWED_MODULES = frozenset({"decoding", "recording", "signing", "testing"})
"""Modules ending in `-ing` whose names are nouns of the field."""

_PARTS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")


@dataclass(frozen=True)
class Complaint:
    """One name that must change."""

    path: Path
    line: int
    text: str

    def __str__(self) -> str:
        path = self.path.relative_to(_ROOT) if self.path.is_relative_to(_ROOT) else self.path
        return f"{path}:{self.line}: {self.text}"


def main(arguments: list[str]) -> int:
    """Print all complaints about the files below the given paths and return the exit code."""
    paths = [Path(argument).resolve() for argument in arguments] or list(_SOURCES)
    files = sorted(file for path in paths for file in ([path] if path.is_file() else path.rglob("*.py")))
    complaints = [*(complaint for file in files for complaint in check_file(file)), *check_class_names(files)]
    for complaint in complaints:
        sys.stdout.write(f"{complaint}\n")
    return 1 if complaints else 0


def check_file(path: Path) -> Iterator[Complaint]:
    """Yield the complaints about the names that one file defines."""
    if path.stem.endswith("ing") and path.stem not in ALLOWED_MODULES and not path.stem.startswith("test_"):
        yield Complaint(path, 1, f"module {path.stem}: named by a participle")
    reported = set[str]()
    for line, name in _defined_names(ast.parse(path.read_text())):
        reason = _reason_against(name)
        if reason and name not in reported:
            reported.add(name)
            yield Complaint(path, line, f"{name}: {reason}")


def check_class_names(files: Iterable[Path]) -> Iterator[Complaint]:
    """Yield a complaint for each class of `src` whose name another class of `src` has."""
    places = defaultdict[str, list[tuple[Path, int]]](list)
    for path in (_ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places[node.name].append((path, node.lineno))
    chosen = set(files)
    for name, where in sorted(places.items()):
        for path, line in where:
            if len(where) > 1 and path in chosen:
                others = ", ".join(
                    f"{other.relative_to(_ROOT)}:{at}" for other, at in where if (other, at) != (path, line)
                )
                yield Complaint(path, line, f"class {name}: also defined in {others}")


def _reason_against(name: str) -> str | None:
    if name.strip("_") in VAGUE:
        return "says nothing about the value"
    words = {part.lower() for part in _PARTS.findall(name)} & BANNED
    return f"contains the banned word {min(words)!r}" if words else None


def _defined_names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield node.lineno, node.name
            case ast.arg():
                yield node.lineno, node.arg
            case ast.Name(ctx=ast.Store()):
                yield node.lineno, node.id
            case ast.Attribute(ctx=ast.Store()):
                yield node.lineno, node.attr
            case ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                yield node.lineno, name
            case ast.alias(asname=str(name)):
                yield 0, name
            case _:
                continue


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
