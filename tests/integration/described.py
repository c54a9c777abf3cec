"""Every answer that a test gets is held to the API's own description: its status, and the code of a failure."""

import re
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

from kleinkram.server.app import create_app
from kleinkram.server.settings import Settings

# What is described does not depend on settings; and a test may add routes of its own to the app that it asks.
_SETTINGS = {
    "database_url": "postgresql://kleinkram_serve@localhost/kleinkram",
    "s3_internal_url": "http://localhost:8333",
    "s3_access_key": "key",
    "s3_secret_key": "secret",
}


class _Operation(NamedTuple):
    path: re.Pattern[str]
    name: str
    responses: dict[str, Any]


def see_that_it_is_described(method: str, path: str, status: int, body: Any) -> None:
    """Fail where an operation answers what the description does not say of it."""
    for operation in _operations().get(method, ()):
        if operation.path.fullmatch(path):
            listed = operation.responses.get(str(status))
            assert listed is not None, f"{operation.name} answered {status}, which server/failures.py does not list"
            code = body["code"] if status >= 400 else ""
            assert code in listed["description"], f"{operation.name}: server/failures.py does not list {code}"
            return


@cache
def _operations() -> dict[str, Sequence[_Operation]]:
    found: dict[str, list[_Operation]] = {}
    paths = create_app(Settings.model_validate(_SETTINGS)).openapi()["paths"]
    for path in sorted(paths, key=lambda path: path.count("{")):  # what is written out goes first
        pattern = re.compile(re.sub(r"\{[^}]+\}", "[^/]+", path))
        for method, told in paths[path].items():
            row = _Operation(pattern, told["operationId"], told["responses"])
            found.setdefault(method.upper(), []).append(row)
    return dict(found)
