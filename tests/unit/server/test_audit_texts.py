"""Every audited operation has a text in the web interface."""

import re
from pathlib import Path

from fastapi.routing import APIRoute

from kleinkram.server.access.operations import OPERATIONS
from kleinkram.server.app import ROUTERS
from kleinkram.server.audit.requests import is_admin_read

_ROOT = Path(__file__).parents[3]
_TEXTS = (_ROOT / "web/src/texts/audit.ts").read_text()


def _worded(name: str) -> dict[str, str]:
    (block,) = re.findall(rf"const {name}: [^=]*= {{\n(.*?)\n}};", _TEXTS, re.DOTALL)
    return dict(re.findall(r'^  "?([a-z_.]+)"?: "(.+)",$', block, re.MULTILINE))


def _recorded() -> set[str]:
    """Return what the server's code calls the acts that it records, of the resource types that have acts."""
    resource_types = {act.partition(".")[0] for act in _worded("operations")}
    code = [path.read_text() for path in (_ROOT / "src/kleinkram/server").rglob("*.py") if path.parent.name != "tables"]
    result = {result for text in code for result in re.findall(r'"([a-z]+\.[a-z_]+)"', text)}
    return {
        act
        for act in result
        if act.partition(".")[0] in resource_types and act.rpartition(".")[2] not in {"id", "css", "js"}
    }


def test_every_audited_read_has_a_description() -> None:
    routes = [route for router in ROUTERS for route in router.routes if isinstance(route, APIRoute)]
    read = {route.operation_id for route in routes if "GET" in (route.methods or ())}
    reads = {operation for operation in OPERATIONS if operation in read and is_admin_read(operation)}
    assert _worded("reads").keys() == reads


def test_every_audited_operation_has_a_description() -> None:
    assert _recorded() - _worded("operations").keys() == set()
