"""Every page on desktop or phone, light or dark, with hostile names, has no errors and executes no markup."""

import json
import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.system.cluster import Cluster
from tests.system.web import every_page_world as hostile
from tests.system.web.conftest import WEB, RunBrowser

_TEXTS = {
    "project": hostile.PROJECT,
    "mission": hostile.MISSION,
    "group": hostile.GROUP,
    "person": hostile.PERSON,
    "token": hostile.TOKEN,
    "label": hostile.LABEL,
    "share": hostile.SHARE,
    "notes": hostile.NOTES,
    "value": hostile.VALUE,
    "address": hostile.ADDRESS,
    "description": hostile.DESCRIPTION,
    "topic": hostile.TOPIC,
    "type": hostile.TYPE,
    "recording": hostile.RECORDING,
    "text": hostile.TEXT,
    "broken": hostile.BROKEN,
    "action": hostile.ACTION,
    "profile": hostile.PROFILE,
    "reason": hostile.REASON,
    "gone": f"gone {hostile.LABEL}",
}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_page_is_accessible_and_executes_no_markup(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    _check_pages(cluster, run_browser, pictures, tmp_path, all_views=False)


@pytest.mark.soak
def test_every_page_is_accessible_and_executes_no_markup_in_all_views(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    _check_pages(cluster, run_browser, pictures, tmp_path, all_views=True)


def _check_pages(cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path, *, all_views: bool) -> None:
    cluster.start()
    world = hostile.make_world(cluster.terminal, tmp_path)
    store = urlsplit(cluster.runtime_info()["store_url"])
    inputs = {
        "invitation": world.invitation,
        "unused": world.unused_invitation,
        "share": world.share,
        "ids": world.ids,
        "texts": _TEXTS,
        "store": f"{store.scheme}://{store.netloc}",
        "allViews": all_views,
    }
    results = run_browser("every_page.mjs", cluster, pictures, json.dumps(inputs), timeout_s=840)

    assert results["executed"] == [], "a name was executed as code"
    assert results["foreignRequests"] == [], "a page sent a request to another host"
    assert results["missingTexts"] == [], "a page does not show a text unchanged"
    assert results["links"] == [], "a link has another scheme than http"
    assert results["consoleErrors"] == []
    assert results["cspViolations"] == []
    assert results["overflowing"] == [], "a page is wider than its viewport"
    assert results["axe"] == []
    assert set(results["inlineScripts"].values()) == {False}
    for name, policy in results["policies"].items():
        assert _script_sources(policy) <= {"'self'", "'wasm-unsafe-eval'"}, name
    assert _routes() - {"not-found"} <= {*results["visitedPages"]}, "a page is not checked"


def _script_sources(policy: str) -> set[str]:
    allowed = {words[0]: set(words[1:]) for rule in policy.split(";") if (words := rule.split())}
    assert allowed["default-src"] == {"'none'"}
    return allowed["script-src"]


def _routes() -> set[str]:
    """Return the names of all pages of the app, as the browser program calls them."""
    named = {"file": "file-drive"}, {"admin": "admin-storage"}
    routes = re.findall(r'name: "([a-z-]+)"', (WEB / "src" / "router" / "routes.ts").read_text())
    assert len(routes) > 10
    return {named[0].get(route) or named[1].get(route) or route for route in routes}
