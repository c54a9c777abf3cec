"""Routes of share links: for those who create them and those who open them; and the pages that a link opens."""

import uuid
from functools import cache
from importlib import resources
from typing import Annotated

from fastapi import APIRouter, Query, Response
from fastapi.responses import HTMLResponse

from kleinkram.contract.base import Page
from kleinkram.contract.errors import NotFound
from kleinkram.contract.tokens import SHARE_PAGE, ShareCreate, SharedRead, ShareMade, ShareRead
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import PAGE_POLICY
from kleinkram.server.http.web_app import PAGE_HEAD, app_page, brand
from kleinkram.server.pagination import PageQuery
from kleinkram.server.settings import Settings
from kleinkram.server.shares import service

router = APIRouter(prefix="/api/v1", tags=["shares"], responses=FAILURE_RESPONSES)


class ShareListQuery(PageQuery):
    """Query parameters of the list of links."""

    mission_id: uuid.UUID | None = None
    ended: bool = False


@router.post("/missions/{mission_id}/shares", operation_id="create_share", status_code=201)
async def create_share(
    mission_id: uuid.UUID, request: ShareCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> ShareMade:
    """Create a link to a mission or some of its files; its secret is shown only once, in this response."""
    return await service.create_share(db, actor, settings=settings, mission_id=mission_id, request=request)


@router.get("/shares", operation_id="list_shares")
async def list_shares(
    query: Annotated[ShareListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[ShareRead]:
    """List the links that you may revoke, latest first; with `ended`, also revoked and expired ones."""
    return await service.list_shares(db, actor, mission_id=query.mission_id, with_ended=query.ended, page=query.page)


@router.delete("/shares/{share_id}", operation_id="revoke_share", status_code=204)
async def revoke_share(share_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Revoke a link, from the next request on."""
    await service.revoke_share(db, actor, share_id=share_id)


@router.get("/share", operation_id="get_share")
async def get_shared(db: Transaction, actor: CurrentActor) -> SharedRead:
    """Return what the link of this request shows."""
    return await service.get_shared(db, actor)


# For people, not part of the API. The server does not learn the secret, so the pages are the same for every link.
page_router = APIRouter(prefix=SHARE_PAGE, include_in_schema=False)
_STATIC = {"share.js": "text/javascript", "share.css": "text/css"}
_HEAD = (
    '<!doctype html><html lang="en"><head><meta charset="utf-8">'
    '<meta name="viewport" content="width=device-width, initial-scale=1"><title>Shared · Kleinkram</title>'
    f'{PAGE_HEAD}<link rel="stylesheet" href="{SHARE_PAGE}/static/share.css">'
    f'<script src="{SHARE_PAGE}/static/share.js" defer></script></head><body>'
)
_MAIN = (
    '<main><h1>Shared with you</h1><p id="message" role="status" hidden></p><p id="what"></p>'
    '<p><a id="view" hidden>View the recordings</a></p>'
    '<div id="all" hidden><button type="button" id="download" class="primary"></button>'
    '<p id="progress" role="status"></p><p>With the command line: <code id="command"></code></p></div>'
    '<div id="about" hidden><img id="picture" alt="" hidden><dl id="metadata"></dl></div>'
    '<details id="topics" hidden><summary></summary><table><thead><tr><th>Topic</th><th>Type</th><th>Messages</th></tr>'
    "</thead><tbody></tbody></table></details>"
    '<h2>Files</h2><table><tbody id="files"></tbody></table>'
    '<button type="button" id="more" hidden>More</button>'
    "<noscript><p>This page needs JavaScript; `klein download ADDRESS` does without.</p></noscript>"
    "</main></body></html>"
)


@page_router.get("")
async def page(settings: CurrentSettings) -> HTMLResponse:
    """Show the page that a link opens."""
    return HTMLResponse(_HEAD + brand(settings) + _MAIN, headers={"Content-Security-Policy": share_policy(settings)})


def share_policy(settings: Settings) -> str:
    """Return the content policy: that of other pages, the store for files and images, and `blob:` for thumbnails."""
    store = settings.store_origin
    shown = PAGE_POLICY.replace("img-src 'self'", f"img-src 'self' {store} blob:")
    return shown.replace("connect-src 'self'", f"connect-src 'self' {store}")


@page_router.get("/view")
async def view(settings: CurrentSettings) -> Response:
    """Show the viewer of the recordings that a link shares."""
    return app_page(settings, policy=viewer_policy(settings))


def viewer_policy(settings: Settings) -> str:
    """Return the content policy of that viewer: scripts and workers of this server, data of the store, map images."""
    tiles = "" if settings.tiles_origin is None else f" {settings.tiles_origin}"
    return (
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; font-src 'self'; "
        f"img-src 'self' blob:{tiles}; connect-src 'self' {settings.store_origin}; worker-src 'self'; "
        "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    )


@page_router.get("/static/{name}")
async def static(name: str) -> Response:
    """Return the script or stylesheet of the page."""
    if name not in _STATIC:
        raise NotFound(resource_type="page", ref=name)
    return Response(_read(name), media_type=_STATIC[name])


@cache
def _read(name: str) -> bytes:
    return (resources.files("kleinkram.server.shares") / "static" / name).read_bytes()
