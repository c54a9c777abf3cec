"""Routes that serve the built web app: its page at each address of a view, and its static files."""

from fastapi import APIRouter, Request, Response
from starlette.exceptions import HTTPException

from kleinkram.server.access.operations import WEB_PATHS
from kleinkram.server.http.dependencies import CurrentSettings
from kleinkram.server.http.web_app import (
    DAY,
    FOREVER,
    app_page,
    asks_for_json,
    built_file,
    is_original_api_path,
    is_page_request,
    static_file,
)

# Not part of the API.
router = APIRouter(include_in_schema=False)


async def view(request: Request, settings: CurrentSettings) -> Response:
    """Return the page of the app; it shows the view of the address.

    Raises:
        HTTPException: 404, for a program that accepts only JSON.
    """
    if asks_for_json(request) or (not is_page_request(request) and is_original_api_path(request.url.path)):
        raise HTTPException(404)
    return app_page(settings)


router.add_api_route("/", view)
for _path in WEB_PATHS:
    router.add_api_route(f"/{_path}", view)
    router.add_api_route(f"/{_path}/{{rest:path}}", view)


@router.get("/assets/{name}")
async def asset(name: str, request: Request, settings: CurrentSettings) -> Response:
    """Return a built file, whose name contains its hash."""
    return built_file(request, settings, f"assets/{name}", caching=FOREVER)


@router.get("/fonts/{name}")
async def font(name: str, request: Request, settings: CurrentSettings) -> Response:
    """Return a font or its licence."""
    return built_file(request, settings, f"fonts/{name}", caching=DAY)


@router.get("/licences.md")
async def licences(request: Request, settings: CurrentSettings) -> Response:
    """Return the licences of the app's dependencies."""
    return built_file(request, settings, "licences.md", caching=DAY)


@router.get("/static/{name}")
async def static(name: str) -> Response:
    """Return a file that the server's own pages share with the app."""
    return static_file(name)
