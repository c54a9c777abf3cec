"""Serves the built web app: its page at each path of a view, its files, and what the server's own pages share.

Serves only files that were built with the wheel or by `make setup`; names cannot escape their folder.
"""

import re
from html import escape
from pathlib import Path
from typing import Final

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse, HTMLResponse, Response
from starlette.exceptions import HTTPException

from kleinkram.contract.errors import NotFound
from kleinkram.server.access.operations import WEB_PATHS
from kleinkram.server.http.dependencies import CurrentSettings
from kleinkram.server.http.headers import PAGE_POLICY
from kleinkram.server.settings import Settings

BUILT: Final = Path(__file__).parent.parent / "web" / "built"
STATIC: Final = Path(__file__).parent.parent / "web" / "static"
# Built files are named after their content, so they never change.
FOREVER: Final = "public, max-age=31536000, immutable"
DAY: Final = "public, max-age=86400"
HOUR: Final = "public, max-age=3600"
# Shared by the server's own pages and the app: colours, fonts, theme, icon.
PAGE_HEAD: Final = (
    '<meta name="color-scheme" content="light dark"><link rel="icon" href="/static/icon.svg" type="image/svg+xml">'
    '<link rel="stylesheet" href="/static/fonts.css"><link rel="stylesheet" href="/static/tokens.css">'
    '<script src="/static/theme.js"></script>'
)
_TYPES: Final = {
    ".css": "text/css",
    ".js": "text/javascript",
    ".md": "text/plain",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".txt": "text/plain",
    ".wasm": "application/wasm",
    ".woff2": "font/woff2",
}
_SMALLER: Final = (("br", ".br"), ("gzip", ".gz"))  # the smallest first
# Addresses for programs: a missing one is answered with a problem document.
_OF_PROGRAMS: Final = ("/api/", "/assets/", "/fonts/", "/health/", "/static/", "/s/static/", "/sign-in/static/")
# Paths of the original Kleinkram's API that are no views of the app, and those below views.
_ORIGINALS_PATH = re.compile(
    r"/(auth|users?|templates|triggers|metadata-types|action|hooks|tag|queue|topic|worker|access|category|user)(/.*)?"
    r"|/(projects?|missions?|files?|actions)/(many|filtered|one|byName|ofMission|running|script|temporaryAccess|download"
    r"|exists|upload|uploads|recent|getDefaultRights|mergeMetadata|migrate|verify)(/.*)?"
)
_NOT_BUILT: Final = (
    '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Kleinkram</title></head><body><main>'
    "<h1>The web interface is not built</h1><p>This server runs from a checkout: <code>make setup</code> builds it. "
    'The API and the program <code>klein</code> work without; so does <a href="/sign-in">signing in</a>.</p>'
    "</main></body></html>"
)


def app_policy(settings: Settings) -> str:
    """Return the content policy of the app: its own scripts, this server, the store, and images of a map, if set."""
    tiles = "" if settings.tiles_origin is None else f" {settings.tiles_origin}"
    return (
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; font-src 'self'; "
        f"img-src 'self' blob: data:{tiles}; media-src {settings.store_origin}; "
        # data: is how the decompression of zstd brings its WebAssembly.
        f"connect-src 'self' {settings.store_origin} data:; worker-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    )


def app_page(settings: Settings, *, status: int = 200, policy: str | None = None) -> Response:
    """Return the page of the app, which shows the view of its address; `policy` replaces the app's content policy."""
    page = BUILT / "index.html"
    if not page.is_file():
        return HTMLResponse(_NOT_BUILT, status_code=503, headers={"Content-Security-Policy": PAGE_POLICY})
    headers = {"Content-Security-Policy": policy or app_policy(settings), "Cache-Control": "no-cache"}
    return HTMLResponse(page.read_bytes(), status_code=status, headers=headers)


def brand(settings: Settings) -> str:
    """Return the header of the server's own pages: the lab's name, with a link to the app."""
    icon = '<img src="/static/icon.svg" alt="" width="28" height="28">'
    return f'<header><a class="brand" href="/">{icon}{escape(settings.lab_name)}</a></header>'


def is_page_request(request: Request) -> bool:
    """Whether a browser requests a page, rather than a program an API response."""
    is_navigation = request.method == "GET" and "text/html" in request.headers.get("accept", "")
    return is_navigation and not request.url.path.startswith(_OF_PROGRAMS)


def asks_for_json(request: Request) -> bool:
    """Whether a program requests JSON rather than a page."""
    accepted = request.headers.get("accept", "")
    return "json" in accepted and "text/html" not in accepted


def is_original_api_path(path: str) -> bool:
    """Whether only the API of the original Kleinkram has this path."""
    return _ORIGINALS_PATH.fullmatch(path) is not None


def built_file(request: Request, settings: Settings, name: str, *, caching: str) -> Response:
    """Return a file of the app, in the smallest encoding that the browser accepts.

    Scripts carry the app's policy too, because workers are subject to their own policy instead of the page's.

    Raises NotFound.
    """
    headers = {"Content-Security-Policy": app_policy(settings), "Cache-Control": caching}
    path = _within(BUILT, name)
    accepted = {part.split(";")[0].strip() for part in request.headers.get("accept-encoding", "").split(",")}
    for coding, ending in _SMALLER:
        smaller = path.with_name(path.name + ending)
        if coding in accepted and smaller.is_file():
            more = {"Content-Encoding": coding, "Vary": "Accept-Encoding"}
            return FileResponse(smaller, media_type=_TYPES[path.suffix], headers=headers | more)
    return FileResponse(path, media_type=_TYPES[path.suffix], headers=headers | {"Vary": "Accept-Encoding"})


def static_file(name: str) -> Response:
    """Return a file that the server's own pages share with the app. Raises NotFound."""
    path = _within(STATIC, name)
    return FileResponse(path, media_type=_TYPES[path.suffix], headers={"Cache-Control": HOUR})


def _within(folder: Path, name: str) -> Path:
    path = folder / name
    if path.suffix not in _TYPES or ".." in path.parts or not path.is_file():
        raise NotFound(resource_type="page", ref=name)
    return path


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
