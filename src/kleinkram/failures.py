"""Formats the error of a failed command: one sentence, or one line of JSON with `--json`.

Imports no other module of ours, because the runner and other small processes use it.
"""

import json
import re
from collections.abc import Mapping


def code_of(error: BaseException) -> str:
    """Return the code of an error that is not in the contract: its class name in snake case."""
    return re.sub("(?<!^)(?=[A-Z])", "_", type(error).__name__).lower()


def failure_line(
    message: str, *, code: str, exit_code: int, as_json: bool, fields: Mapping[str, object] | None = None
) -> str:
    """Return the line for stderr."""
    if not as_json:
        return f"Error: {message}"
    return json.dumps(
        {"error": {**(fields or {}), "code": code, "message": message, "exit_code": exit_code}}, default=str
    )
