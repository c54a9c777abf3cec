"""The page that a link opens: the same for every link, since the server is not told the link's secret.

Plain HTML, one script and one stylesheet of ours, nothing inline; files and a picture come from the store.
"""

from functools import cache
from importlib import resources

from fastapi import APIRouter, Response
from fastapi.responses import HTMLResponse

from kleinkram.contract.errors import NotFound
from kleinkram.contract.shares import SHARE_PAGE
from kleinkram.server.http.dependencies import CurrentSettings
from kleinkram.server.http.headers import PAGE_POLICY
from kleinkram.server.http.pages import PAGE_HEAD, brand
from kleinkram.server.settings import Settings

# Not part of the API: for people, not for programs.
router = APIRouter(prefix=SHARE_PAGE, include_in_schema=False)
_STATIC = {"share.js": "text/javascript", "share.css": "text/css"}
_HEAD = (
    '<!doctype html><html lang="en"><head><meta charset="utf-8">'
    '<meta name="viewport" content="width=device-width, initial-scale=1"><title>Shared · Kleinkram</title>'
    f'{PAGE_HEAD}<link rel="stylesheet" href="{SHARE_PAGE}/static/share.css">'
    f'<script src="{SHARE_PAGE}/static/share.js" defer></script></head><body>'
)
_MAIN = (
    '<main><h1>Shared with you</h1><p id="said" role="status" hidden></p><p id="what"></p>'
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


@router.get("")
async def page(settings: CurrentSettings) -> HTMLResponse:
    """Show the page of a link."""
    return HTMLResponse(_HEAD + brand(settings) + _MAIN, headers={"Content-Security-Policy": share_policy(settings)})


def share_policy(settings: Settings) -> str:
    """Return what the page may do: as other pages of ours, and fetch and show what is shared from the store."""
    store = settings.store_origin
    shown = PAGE_POLICY.replace("img-src 'self'", f"img-src 'self' {store}")
    return shown.replace("connect-src 'self'", f"connect-src 'self' {store}")


@router.get("/static/{name}")
async def static(name: str) -> Response:
    """Give the page's script and stylesheet."""
    if name not in _STATIC:
        raise NotFound(noun="page", ref=name)
    return Response(_read(name), media_type=_STATIC[name])


@cache
def _read(name: str) -> bytes:
    return (resources.files("kleinkram.server.shares") / "static" / name).read_bytes()
