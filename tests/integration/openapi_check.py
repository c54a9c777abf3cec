"""Checks that each response of the API matches its OpenAPI document."""

import re
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

from kleinkram.contract.errors import ERRORS
from kleinkram.contract.problems import ProblemDocument
from kleinkram.server.app import create_app
from kleinkram.server.settings import Settings

# The document does not depend on the settings. A test may add routes to its own app, so this one is separate.
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


def assert_is_described(method: str, path: str, status: int, body: Any) -> None:
    """Fail if an operation answers with a status that OpenAPI does not list, or with a failure that is no problem."""
    for operation in _operations().get(method, ()):
        if operation.path.fullmatch(path):
            if status < 400:
                assert str(status) in operation.responses, f"{operation.name} answered {status}, not in OpenAPI"
            else:
                assert "default" in operation.responses, f"{operation.name} describes no failures"
                problem = ProblemDocument.model_validate(body)
                assert status == problem.status == ERRORS[problem.code].status, f"{operation.name}: {body}"
            return


@cache
def _operations() -> dict[str, Sequence[_Operation]]:
    operations: dict[str, list[_Operation]] = {}
    paths = create_app(Settings.model_validate(_SETTINGS)).openapi()["paths"]
    for path in sorted(paths, key=lambda path: path.count("{")):  # literal paths win over templates
        pattern = re.compile(re.sub(r"\{[^}]+\}", "[^/]+", path))
        for method, operation in paths[path].items():
            row = _Operation(pattern, operation["operationId"], operation["responses"])
            operations.setdefault(method.upper(), []).append(row)
    return dict(operations)
