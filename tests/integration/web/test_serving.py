"""Serving the web interface: paths, sizes, caching and content security policy."""

import gzip
import re
import uuid
from pathlib import Path

import pytest
import urllib3

from kleinkram.server.access.operations import WEB_PATHS
from kleinkram.server.http.web_app import BUILT
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi

_POOL = urllib3.PoolManager(retries=False, timeout=20)
_ROUTES = Path(__file__).parents[3] / "web" / "src" / "router" / "routes.ts"
_LOOKING = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}


def _get(api: Api, path: str, **headers: str) -> urllib3.BaseHTTPResponse:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return _POOL.request("GET", api.url + path, headers=named, decode_content=False, redirect=False)


def _script(api: Api) -> str:
    match = re.search(r'src="(/assets/[^"]+\.js)"', _get(api, "/").data.decode())
    assert match is not None
    return match[1]


def test_every_view_is_the_app(api: Api) -> None:
    page = _get(api, "/")
    assert (page.status, page.headers["cache-control"]) == (200, "no-cache")
    assert '<div id="app">' in page.data.decode()
    for path in ("/projects", f"/projects/{uuid.uuid4()}", f"/missions/{uuid.uuid4()}?tab=topics", "/signed-in"):
        assert _get(api, path).data == page.data, path


def test_the_server_serves_every_route_of_the_app() -> None:
    paths = re.findall(r'path: "/([a-z][a-z-]*)', _ROUTES.read_text(encoding="utf-8"))
    assert sorted(set(paths) - {"s"}) == sorted(WEB_PATHS), "share links have routes of their own, with this view"


def test_not_found_is_a_page_for_browsers_and_a_problem_for_programs(api: Api) -> None:
    page = _get(api, "/nothing/of/the/kind", **_LOOKING)
    assert (page.status, page.headers["content-type"]) == (404, "text/html; charset=utf-8")
    for path, headers in (
        ("/nothing", {}),
        ("/api/v1/nothing", _LOOKING),
        ("/assets/nothing.js", _LOOKING),
        ("/assets/..%2Findex.html", _LOOKING),
        ("/static/..%2Froutes.py", _LOOKING),
        ("/fonts/nothing.woff2", _LOOKING),
    ):
        answer = _get(api, path, **headers)
        assert (answer.status, answer.headers["content-type"]) == (404, "application/problem+json"), path
    assert _POOL.request("POST", f"{api.url}/api/v1/nothing").status == 404


def test_the_former_client_receives_the_name_of_the_client_to_install(api: Api) -> None:
    carried = {"Kleinkram-Client-Version": "0.63.3", "Accept": "*/*"}
    requests = [("GET", path, carried) for path in ("/", "/users/me", "/projects", "/missions/x", "/api/v1/projects")]
    requests += [("POST", "/missions", carried), ("DELETE", "/files", carried), ("PUT", "/anything", carried)]
    requests += [("GET", path, {"Accept": "*/*"}) for path in ("/projects/many", "/missions/filtered", "/users/me")]
    requests += [("GET", "/auth/google?state=cli-port-8000", _LOOKING)]
    for method, path, headers in requests:
        answer = _POOL.request(method, api.url + path, headers=headers, redirect=False)
        assert (answer.status, answer.headers["content-type"]) == (404, "application/problem+json"), path
        problem = answer.json()
        assert problem["code"] == "wrong_client", path
        assert problem["message"] == problem["detail"]
        assert "pip install open-kleinkram" in problem["detail"]
        assert api.app.state.settings.public_url in problem["detail"]


def test_programs_that_ask_for_json_never_get_a_page(api: Api) -> None:
    for path in ("/", "/projects", f"/missions/{uuid.uuid4()}", "/api/v2/projects", "/api/nothing", "/no/such/place"):
        answer = _get(api, path, Accept="application/json")
        assert (answer.status, answer.headers["content-type"]) == (404, "application/problem+json"), path
    assert _get(api, "/projects", Accept="text/html,application/json;q=0.9").status == 200
    assert _get(api, "/users/me", **_LOOKING).headers["content-type"].startswith("text/html")


def test_the_content_security_policy_allows_own_scripts_and_the_store(api: Api) -> None:
    settings = api.app.state.settings
    for path in ("/", "/projects", _script(api)):
        policy = _get(api, path).headers["content-security-policy"]
        directives = dict(part.strip().split(" ", 1) for part in policy.split(";"))
        assert directives["default-src"] == "'none'"
        assert directives["script-src"] == "'self' 'wasm-unsafe-eval'"
        assert directives["style-src"] == directives["worker-src"] == "'self'"
        assert directives["connect-src"] == f"'self' {settings.store_origin} data:"
        assert directives["media-src"] == settings.store_origin
        assert directives.keys().isdisjoint({"frame-src", "object-src"}), "files of others are never framed"
        assert directives["frame-ancestors"] == "'none'"
    html = _get(api, "/").data.decode()
    assert not re.search(r"<script(?![^>]*\ssrc=)|<style|\sstyle=|\son\w+=", html), "nothing inline"
    assert not re.search(r"(src|href)=\"(https?:)?//", html), "nothing from elsewhere"


def test_images_of_map_tiles_are_allowed_from_their_server_alone(start_api: StartApi, api: Api) -> None:
    source = {"map_tiles_url": "https://Tiles.example:443/{z}/{x}/{y}.png?key=k", "map_tiles_attribution": "© A <b>"}
    with_tiles = start_api(**source, map_tiles_max_zoom=17)
    policies = [_get(server, "/").headers["content-security-policy"] for server in (api, with_tiles)]
    assert policies[1] == policies[0].replace(
        "img-src 'self' blob: data:;", "img-src 'self' blob: data: https://tiles.example;"
    )
    assert api.get("/service").ok()["map_tiles"] is None
    shown = with_tiles.as_(None).get("/service").ok()["map_tiles"]
    assert shown == {"url": source["map_tiles_url"], "attribution": "© A <b>", "max_zoom": 17}


def test_built_assets_are_cached_forever_and_sent_compressed(api: Api) -> None:
    path = _script(api)
    plain = _get(api, path)
    assert plain.status == 200
    assert "immutable" in plain.headers["cache-control"]
    assert plain.headers["content-type"].startswith("text/javascript")
    assert plain.headers["vary"] == "Accept-Encoding"
    small = _get(api, path, Accept_Encoding="gzip, deflate")
    assert (small.headers["content-encoding"], gzip.decompress(small.data)) == ("gzip", plain.data)
    smallest = _get(api, path, Accept_Encoding="gzip, deflate, br")
    assert smallest.headers["content-encoding"] == "br"
    assert len(smallest.data) < len(small.data) < len(plain.data)


@pytest.mark.parametrize("path", ["/static/tokens.css", "/static/theme.js", "/static/icon.svg", "/fonts/inter.woff2"])
def test_the_server_s_own_pages_share_colours_and_letters(api: Api, path: str) -> None:
    answer = _get(api, path)
    assert (answer.status, len(answer.data) > 100) == (200, True)
    assert answer.headers["cache-control"].startswith("public")


def test_the_first_load_is_small() -> None:
    """What `/` asks for before anything is shown: 350 kB with gzip at most."""
    html = (BUILT / "index.html").read_text(encoding="utf-8")
    names = re.findall(r'(?:src|href)="/((?:assets|fonts)/[^"]+)"', html)
    assert len(names) >= 2
    sizes = [next(p for p in (BUILT / f"{name}.gz", BUILT / name) if p.exists()).stat().st_size for name in names]
    assert sum(sizes) < 350_000
