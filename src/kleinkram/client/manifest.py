"""Manifests: an action as a folder with `action.yaml`, or as one script that says what it is in its first comment."""

import re
import sys
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml.error import YAMLError

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import MAX_SCRIPT_CHARACTERS, ActionDefinition
from kleinkram.contract.problems import first_problem
from kleinkram.recordings.yaml_depth import shallow_yaml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MANIFEST = "action.yaml"
MAIN = "main.py"
_MOST_BYTES = 1_000_000
_MAX_DEPTH = 50
# Source: PEP 723, "Inline script metadata", its reference implementation.
_BLOCK = re.compile(r"(?m)^# /// script$\s(?P<content>(^#(| .*)$\s)+)^# ///$")


def read_manifest(path: Path) -> ActionDefinition:
    """Return the action that a folder with `action.yaml`, such a file, or a Python script with a PEP 723 header is.

    A folder without `action.yaml` is the script `main.py` in it.
    A script's header may hold a table `[tool.kleinkram]` with all that `action.yaml` could say; its name is the file's,
    where it says none. What it needs to be installed stands in `dependencies`, as PEP 723 says.

    Raises:
        InvalidInput: there is none, or it is not a definition; says where and why.
    """
    file = path
    if path.is_dir():
        file = path / (MAIN if (path / MAIN).exists() and not (path / MANIFEST).exists() else MANIFEST)
    try:
        with file.open("rb") as stream:
            text = stream.read(_MOST_BYTES).decode()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise InvalidInput(what=str(file), reason=f"cannot be read as an action: {reason}") from error
    fields = _of_script(file, text) if file.suffix == ".py" else _of_yaml(file, text)
    try:
        return ActionDefinition.model_validate(fields)
    except ValidationError as error:
        raise InvalidInput(what=str(file), reason=first_problem(error, "the action")) from error


def _of_yaml(file: Path, text: str) -> dict[str, Any]:
    try:
        fields = shallow_yaml("safe", max_depth=_MAX_DEPTH).load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise InvalidInput(what=str(file), reason=f"is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(fields, dict):
        raise InvalidInput(what=str(file), reason="it is not a mapping of names to values")
    return fields


def _of_script(file: Path, text: str) -> dict[str, Any]:
    if len(text) > MAX_SCRIPT_CHARACTERS:
        raise InvalidInput(what=str(file), reason=f"has {len(text)} characters; {MAX_SCRIPT_CHARACTERS} are allowed")
    blocks = _BLOCK.findall(text.replace("\r\n", "\n"))
    if len(blocks) > 1:
        raise InvalidInput(what=str(file), reason="has two headers '# /// script'")
    header: dict[str, Any] = {}
    if blocks:
        lines = (line.removeprefix("#").removeprefix(" ") for line in blocks[0][0].splitlines())
        try:
            header = tomllib.loads("\n".join(lines))
        except tomllib.TOMLDecodeError as error:
            raise InvalidInput(what=str(file), reason=f"its header is not TOML: {error}") from error
    fields = header.get("tool", {}).get("kleinkram", {})
    return {"name": file.stem, **fields, "script": text, "dependencies": header.get("dependencies", [])}
