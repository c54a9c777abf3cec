"""Every route is in the table of operations, or the server does not start."""

import pytest
from fastapi import APIRouter
from fastapi.routing import APIRoute
from starlette.routing import Mount

from kleinkram.contract.errors import ERRORS, ErrorCode
from kleinkram.server.access.operations import OPEN_PAGES, OPERATIONS
from kleinkram.server.app import ROUTERS, create_app, require_guards
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction, requires_actor
from kleinkram.server.settings import Settings

_SETTINGS = {
    "database_url": "postgresql://kleinkram_serve@localhost/kleinkram",
    "s3_internal_url": "http://localhost:8333",
    "s3_access_key": "key",
    "s3_secret_key": "secret",
}


def _routes() -> list[APIRoute]:
    return [route for router in ROUTERS for route in router.routes if isinstance(route, APIRoute)]


def test_every_route_requires_an_actor_or_is_an_open_page() -> None:
    open_to_all = sorted(route.path for route in _routes() if not requires_actor(route))
    assert open_to_all == sorted(OPEN_PAGES)


def test_the_schema_has_exactly_the_routes_of_the_api() -> None:
    """So that nothing is served which tests made from the schema do not see."""
    app = create_app(Settings.model_validate(_SETTINGS))
    described = {operation["operationId"] for path in app.openapi()["paths"].values() for operation in path.values()}
    served = {route.operation_id for route in _routes() if route.path.startswith("/api/")}
    assert described == served
    # The pages of signing in are for people; providers send them back to one, and logout tokens to another.
    assert {route.operation_id for route in _routes()} - served == {
        None,
        "end_provider_sign_in",
        "end_provider_sessions",
    }


def test_every_operation_describes_failures_as_problem_documents() -> None:
    schema = create_app(Settings.model_validate(_SETTINGS)).openapi()
    problem = {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}
    for path in schema["paths"].values():
        for operation in path.values():
            assert operation["responses"]["default"]["content"] == {"application/problem+json": problem}
            assert all(status.startswith(("2", "d")) for status in operation["responses"]), operation["operationId"]
    assert schema["components"]["schemas"]["ErrorCode"]["enum"] == [code.value for code in ErrorCode]
    assert set(ERRORS) == set(ErrorCode)


def test_every_operation_has_a_route_except_derived_ones() -> None:
    routed = {route.operation_id for route in _routes()}
    of_projects = {"publish_project", "set_project_isolation", "set_project_quota"}
    assert OPERATIONS.keys() - routed == {"move_mission", "move_file", "share_viewer_layout", *of_projects}


def test_no_route_is_served_twice() -> None:
    named = [(method, route.path) for route in _routes() for method in route.methods or ()]
    assert len(named) == len(set(named))


def test_a_route_without_permissions_prevents_the_start() -> None:
    router = APIRouter()

    @router.get("/unsaid", operation_id="unsaid")
    async def unsaid(actor: CurrentActor) -> str:
        return actor.name

    with pytest.raises(RuntimeError, match=r"/unsaid has no row"):
        require_guards([router])


def test_a_route_without_authentication_prevents_the_start() -> None:
    router = APIRouter()

    @router.get("/unguarded", operation_id="get_project")
    async def unguarded(settings: CurrentSettings) -> str:
        return settings.public_url

    with pytest.raises(RuntimeError, match=r"/unguarded has no row"):
        require_guards([router])


def test_unknown_route_types_prevent_the_start() -> None:
    router = APIRouter()
    router.routes.append(Mount("/mounted", routes=[]))
    with pytest.raises(RuntimeError, match=r"/mounted has no row"):
        require_guards([router])


def test_a_transaction_requires_an_actor() -> None:
    router = APIRouter()

    @router.get("/with-transaction")
    async def with_transaction(db: Transaction) -> str:
        return str(db)

    (route,) = router.routes
    assert isinstance(route, APIRoute)
    assert requires_actor(route)
