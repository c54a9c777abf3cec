"""Search in a real browser, from a word to downloaded files, and on a map with tiles."""

import io
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import Terminal, wait_until
from tests.http_server import QuietHandler, serving
from tests.klein import KLEIN
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_MARKUP = "Wet <img src=x onerror=alert(1)> <b>grass<b>"
_FIELDS = """
fields:
  - {name: site, type: location}
"""
_TILE = re.compile(r"/tiles/(\d+)/(\d+)/(\d+)\.png\?key=a")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_search_results_are_labelled_shared_and_downloaded(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    with _tile_server() as (port, requests):
        cluster.settings["KLEINKRAM_MAP_TILES_URL"] = f"http://127.0.0.1:{port}/tiles/{{z}}/{{x}}/{{y}}.png?key=a"
        cluster.settings["KLEINKRAM_MAP_TILES_ATTRIBUTION"] = "© <b>Tiles</b> of a test"
        cluster.start()
        sources = _create_missions(cluster.terminal, tmp_path)
        project_id = _create_sites(cluster.terminal, tmp_path)
        results = run_browser("search.mjs", cluster, pictures, project_id)

    _check_results(results)
    _check_map(results["map"], requests, cluster)
    _check_shares(results, cluster.terminal)
    fetched = _run_download_script(results, cluster.terminal, tmp_path)
    assert fetched == {f"Alps/{mission}/drive.mcap": sources[mission] for mission in ("traverse", _MARKUP)}, (
        "equal paths of two missions are kept apart"
    )


def _create_missions(terminal: Terminal, tmp_path: Path) -> dict[str, bytes]:
    """Upload three missions into two projects; return the bytes of the recording of each."""
    sources: dict[str, bytes] = {}
    for seed, (project, mission) in enumerate([("Alps", "traverse"), ("Alps", _MARKUP), ("Lakes", "night")]):
        folder = tmp_path / f"from-{seed}"
        folder.mkdir()
        recording = generate_mcap(folder / "drive.mcap", size_bytes=300_000, seed=seed + 1).path
        sources[mission] = Path(recording).read_bytes()
        (folder / "notes.txt").write_text(f"{mission}\n")
        (folder / "cut.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
        terminal.run("project", "create", project, code=None)
        terminal.run("upload", "-p", project, "-m", mission, "--create", "--wait", f"{folder}/")
    terminal.run("project", "update", "Lakes", "--public")

    def contents() -> list[str]:
        return [file["content"] for file in terminal.run("file", "list", "--json").json()["items"]]

    wait_until(lambda: "pending" not in contents(), "the files to be read")
    wait_until(lambda: contents().count("indexed") == len(sources), "the recordings to be indexed")
    return sources


def _create_sites(terminal: Terminal, tmp_path: Path) -> str:
    """Create a mission with a location, and one without; wait for the positions of recordings; return the project."""
    (tmp_path / "fields.yaml").write_text(_FIELDS)
    (tmp_path / "depot.yaml").write_text("site: {latitude: 46.9, longitude: 7.4, name: Yard}\n")
    project = terminal.run("project", "create", "Sites", "--fields", tmp_path / "fields.yaml", "--json").json()
    terminal.run("mission", "create", "depot", "-p", "Sites", "--metadata", tmp_path / "depot.yaml")
    terminal.run("mission", "create", "nowhere", "-p", "Sites")

    def sources() -> list[str]:
        return sorted(it["source"] for it in terminal.run("mission", "positions", "--json").json()["items"])

    wait_until(lambda: sources() == ["metadata", *["recording"] * 3], "the previews to have positions")
    return str(project["id"])


@contextmanager
def _tile_server() -> Iterator[tuple[int, list[tuple[str, str | None]]]]:
    """Serve tiles of a map, refusing every second one; yield the port, and the paths and referrers of requests."""
    requests: list[tuple[str, str | None]] = []
    png = io.BytesIO()
    Image.new("RGB", (256, 256), (170, 200, 220)).save(png, "PNG")

    class Tiles(QuietHandler):
        def do_GET(self) -> None:
            requests.append((self.path, self.headers.get("Referer")))
            tile = _TILE.fullmatch(self.path)
            is_served = tile is not None and (int(tile[2]) + int(tile[3])) % 2 == 0
            self.send(200 if is_served else 404, png.getvalue() if is_served else b"", {"Content-Type": "image/png"})

    with serving(Tiles) as port:
        yield port, requests


def _check_map(shown: dict[str, Any], requests: list[tuple[str, str | None]], cluster: Cluster) -> None:
    first = shown["shown"]
    assert (first["placed"], first["clusters"], first["missions"]) == (4, ["3"], ["depot"])
    assert "Not on the map: 1 mission with neither a GNSS fix" in first["notes"]
    assert first["attribution"] == "© <b>Tiles</b> of a test"
    assert shown["far"] == ["4"]
    assert shown["near"] == {"clusters": ["3"], "missions": ["depot"]}
    assert sorted(shown["listed"]["names"]) == sorted(["traverse", _MARKUP, "night"])
    assert shown["listed"]["hasFocus"]
    assert shown["opened"] == "depot"
    assert shown["ofProject"] == 1
    visible = {url: visibility == "visible" for url, visibility in first["tiles"]}
    tiles = {url: _TILE.search(url) for url in visible}
    assert len(tiles) > 4
    assert all(visible[url] == ((int(tile[2]) + int(tile[3])) % 2 == 0) for url, tile in tiles.items() if tile)
    assert all(_TILE.fullmatch(path) for path, _ in requests)
    assert {referrer for _, referrer in requests} == {f"http://127.0.0.1:{cluster.port}/"}, "no path, no query"


def _check_results(results: dict[str, Any]) -> None:
    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["executed"] == [], "markup was run"
    assert "1 file broken" in results["home"]
    assert _MARKUP in results["home"]
    assert [tab.split() for tab in results["tabs"]] == [["Files", "9"], ["Missions", "5"], ["Topics", "7"], ["Map"]]
    typed = results["typed"]
    assert typed["urlQuery"] == "alps topic:/imu/* format:mcap"
    assert typed["command"].strip() == "klein search 'alps topic:/imu/* format:mcap'"
    assert sorted(row.split("\n")[-1] for row in typed["rows"]) == sorted([f"Alps / {_MARKUP}", "Alps / traverse"])
    assert results["back"] == {"urlQuery": typed["urlQuery"], "box": typed["urlQuery"]}
    assert results["faceted"]["query"] == results["faceted"]["box"]
    assert results["invalid"]["mark"] == "size:big"
    assert "column 6" in results["invalid"]["message"]
    assert results["invalid"]["rows"] == 2, "the previous results stay visible"


def _check_shares(results: dict[str, Any], terminal: Terminal) -> None:
    assert [row.split("\n")[0] for row in results["markup"]["rows"]] == [_MARKUP]
    assert results["markup"]["elements"] == 0
    assert 'mission:"Wet *" topic:/imu/data' in results["topic"]
    assert {file["path"] for file in terminal.run("file", "list", "--label", "icra 27", "--json").json()["items"]} == {
        "drive.mcap"
    }
    assert results["isShareDisabledForTwoMissions"], "a link shows files of one mission"
    assert results["shared"]["isSelectionChecked"], "the link is limited to the selected files"
    assert results["shared"]["text"].startswith(f"{results['shared']['place']}\n\n1 file, ")
    assert [row.split()[0] for row in results["shared"]["rows"]] == ["drive.mcap"]
    assert [row.split("\n")[0] for row in results["public"]] == ["Lakes"]
    assert {row.split("\n")[-1] for row in results["publicRows"]} == {"Lakes / night"}
    assert results["publicCheckboxes"] == 0, "anonymous visitors cannot select files"


def _run_download_script(results: dict[str, Any], terminal: Terminal, tmp_path: Path) -> dict[str, bytes]:
    """Run the download script, and return the files that it downloads."""
    assert results["downloadSize"].startswith("2 files, ")
    script = tmp_path / "download.sh"
    script.write_text(results["script"])
    path = f"{KLEIN.parent}:{terminal.environment['PATH']}"
    fetched = tmp_path / "fetched"
    subprocess.run(["sh", script, fetched], check=True, env={**terminal.environment, "PATH": path}, timeout=60)
    return {path.relative_to(fetched).as_posix(): path.read_bytes() for path in fetched.rglob("*") if path.is_file()}
