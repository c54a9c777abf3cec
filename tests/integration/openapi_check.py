"""Checks that the OpenAPI document lists each response of the API."""

import re
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

from fastapi.routing import APIRoute

from kleinkram.contract.errors import ERRORS
from kleinkram.contract.problems import ProblemDocument
from kleinkram.server.app import ROUTERS


class _Operation(NamedTuple):
    path: re.Pattern[str]
    name: str
    responses: set[str]


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
    """Return the operations by their method. To make the whole document takes two seconds of CPU time."""
    operations: dict[str, list[_Operation]] = {}
    routes = [route for router in ROUTERS for route in router.routes if isinstance(route, APIRoute)]
    for route in sorted(routes, key=lambda route: route.path.count("{")):  # literal paths win over templates
        if route.include_in_schema:
            pattern = re.compile(re.sub(r"\{[^}]+\}", "[^/]+", route.path))
            responses = {str(route.status_code or 200), *map(str, route.responses)}
            for method in route.methods or ():
                operations.setdefault(method, []).append(_Operation(pattern, route.unique_id, responses))
    return dict(operations)
