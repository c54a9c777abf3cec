"""A YAML reader that refuses deep nesting.

At every open bracket, the usual scanner looks up to 1,024 characters ahead for a key, so its time grows with the square
of the depth. This scanner stops at the bracket or indent that exceeds the limit.

Slow to import (ruamel.yaml): import it where it is needed.
"""

from __future__ import annotations

from typing import Any, Literal

from ruamel.yaml import YAML
from ruamel.yaml.scanner import Scanner, ScannerError


def shallow_yaml(typ: Literal["safe", "base"], *, max_depth: int) -> YAML:
    """Return a reader that raises `ScannerError` where a value is more than `max_depth` levels below the top."""

    class ShallowScanner(Scanner):
        def fetch_flow_collection_start(self, TokenClass: Any, to_push: str) -> None:  # noqa: N803  the base's name
            self._refuse_deeper(self.flow_level + 1 + len(self.indents))
            super().fetch_flow_collection_start(TokenClass, to_push)

        def add_indent(self, column: int) -> bool:
            is_deeper: bool = super().add_indent(column)
            if is_deeper:
                self._refuse_deeper(len(self.indents))
            return is_deeper

        def _refuse_deeper(self, collections: int) -> None:
            if collections > max_depth + 1:
                problem = f"this is nested more than {max_depth} levels deep"
                raise ScannerError(None, None, problem, self.reader.get_mark())

    reader = YAML(typ=typ, pure=True)
    reader.Scanner = ShallowScanner
    return reader
