"""Every page, light and dark, wide and narrow, with names that are attacks."""

import json
import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.system.cluster import Cluster
from tests.system.web import every_page_world as hostile
from tests.system.web.conftest import WEB, Act

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
    "gone": f"gone {hostile.LABEL}",
}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_page(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    _look(cluster, act, pictures, tmp_path, every=False)


@pytest.mark.soak
def test_every_page_in_every_way(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    _look(cluster, act, pictures, tmp_path, every=True)


def _look(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path, *, every: bool) -> None:
    cluster.start()
    world = hostile.make_world(cluster.terminal, tmp_path)
    store = urlsplit(cluster.runtime_info()["store_url"])
    runtime_info = {
        "invitation": world.invitation,
        "unused": world.unused_invitation,
        "share": world.share,
        "ids": world.ids,
        "texts": _TEXTS,
        "store": f"{store.scheme}://{store.netloc}",
        "every": every,
    }
    seen = act("every_page.mjs", cluster, pictures, json.dumps(runtime_info), timeout_s=840)

    assert seen["ran"] == [], "nothing that people named was run"
    assert seen["elsewhere"] == [], "nothing was asked of another host"
    assert seen["unseen"] == [], "it is shown as it was said"
    assert seen["links"] == [], "no link leads to a script"
    assert seen["complaints"] == []
    assert seen["violations"] == []
    assert seen["wide"] == [], "nothing is wider than the page"
    assert seen["axe"] == []
    assert set(seen["inline"].values()) == {False}
    for name, policy in seen["policies"].items():
        assert _scripts_of(policy) <= {"'self'", "'wasm-unsafe-eval'"}, name
    assert _routes() - {"not-found"} <= {*seen["looked"]}, "a page is not looked at"


def _scripts_of(policy: str) -> set[str]:
    allowed = {words[0]: set(words[1:]) for rule in policy.split(";") if (words := rule.split())}
    assert allowed["default-src"] == {"'none'"}
    return allowed["script-src"]


def _routes() -> set[str]:
    """The names of all pages of the app."""
    named = {"file": "file-drive"}, {"admin": "admin-storage"}
    routes = re.findall(r'name: "([a-z-]+)"', (WEB / "src" / "router" / "routes.ts").read_text())
    assert len(routes) > 10
    return {named[0].get(route) or named[1].get(route) or route for route in routes}
