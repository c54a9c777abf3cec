"""How a command prints why it failed: a sentence, or one JSON document in one line where JSON was asked for.

Imports nothing of ours: the processes that a command turns into print failures likewise, and must stay small.
"""

import json
import re
from collections.abc import Mapping


def code_of(error: BaseException) -> str:
    """Return the code of a failure that the contract does not list: its class's name, in small letters."""
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
