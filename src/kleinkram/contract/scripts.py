"""Scripts that describe themselves: a header (PEP 723) with their dependencies and, as `[tool.kleinkram]`, the action.

Source: PEP 723, "Inline script metadata", and its reference implementation.
"""

import re
import sys
from typing import Any

from kleinkram.contract.actions import MAX_SCRIPT_CHARACTERS, ActionDefinition

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_BLOCK = re.compile(r"(?m)^# /// script$\s(?P<content>(^#(| .*)$\s)+)^# ///$")


def read_script(text: str, *, name: str) -> ActionDefinition:
    """Return the action that a script is; `name` is its name where its header has none.

    Raises:
        ValueError: it is too long, has no valid header, or (a ValidationError) is not a definition.
    """
    if len(text) > MAX_SCRIPT_CHARACTERS:
        raise ValueError(f"has {len(text)} characters; {MAX_SCRIPT_CHARACTERS} are allowed")
    header = _header(text)
    fields = header.get("tool", {}).get("kleinkram", {})
    of_header = {"dependencies": header.get("dependencies", [])}
    if "requires-python" in header:
        of_header["requires_python"] = header["requires-python"]
    return ActionDefinition.model_validate({"name": name, **fields, "script": text, **of_header})


def has_header(text: str) -> bool:
    """Return whether a script has a header."""
    return _BLOCK.search(text.replace("\r\n", "\n")) is not None


def _header(text: str) -> dict[str, Any]:
    blocks = _BLOCK.findall(text.replace("\r\n", "\n"))
    if len(blocks) > 1:
        raise ValueError("has two headers '# /// script'")
    if not blocks:
        return {}
    lines = (line.removeprefix("#").removeprefix(" ") for line in blocks[0][0].splitlines())
    try:
        return tomllib.loads("\n".join(lines))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"its header is not TOML: {error}") from error
