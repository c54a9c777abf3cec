"""Search in a real browser, from a word to downloaded files."""

import subprocess
from pathlib import Path
from typing import Any

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import KLEIN, Terminal, wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import Act

_MARKUP = "Wet <img src=x onerror=alert(1)> <b>grass<b>"


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_search_to_download(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    cluster.start()
    sources = _filled(cluster.terminal, tmp_path)

    seen = act("search.mjs", cluster, pictures)

    _check_results(seen)
    _check_shares(seen, cluster.terminal)
    fetched = _fetched(seen, cluster.terminal, tmp_path)
    assert fetched == {f"Alps/{mission}/drive.mcap": sources[mission] for mission in ("traverse", _MARKUP)}, (
        "of one path in two"
    )


def _filled(terminal: Terminal, tmp_path: Path) -> dict[str, bytes]:
    """Three missions in two projects; returns what the recording of each is made of."""
    sources: dict[str, bytes] = {}
    for seed, (project, mission) in enumerate([("Alps", "traverse"), ("Alps", _MARKUP), ("Lakes", "night")]):
        folder = tmp_path / f"from-{seed}"
        folder.mkdir()
        recording = generate_mcap(folder / "drive.mcap", size_bytes=200_000, seed=seed + 1).path
        sources[mission] = Path(recording).read_bytes()
        (folder / "notes.txt").write_text(f"{mission}\n")
        (folder / "cut.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
        terminal.run("project", "create", project, code=None)
        terminal.run("upload", "-p", project, "-m", mission, "--create", "--wait", f"{folder}/")
    terminal.run("project", "update", "Lakes", "--public")

    def contents() -> list[str]:
        return [file["content"] for file in terminal.run("file", "list", "--json").json()["items"]]

    wait_until(lambda: "pending" not in contents(), "the files to be read")
    wait_until(lambda: contents().count("indexed") == len(sources), "the recordings to be known")
    return sources


def _check_results(seen: dict[str, Any]) -> None:
    assert seen["complaints"] == []
    assert seen["axe"] == []
    assert seen["wide"] == []
    assert seen["ran"] == [], "markup was run"
    assert "1 file broken" in seen["home"]
    assert _MARKUP in seen["home"]
    assert [tab.split() for tab in seen["all"]] == [["Files", "9"], ["Missions", "3"], ["Topics", "7"]]
    typed = seen["typed"]
    assert typed["asked"] == "alps topic:/imu/* format:mcap"
    assert typed["command"].strip() == "klein search 'alps topic:/imu/* format:mcap'"
    assert sorted(row.split("\n")[-1] for row in typed["rows"]) == sorted([f"Alps / {_MARKUP}", "Alps / traverse"])
    assert seen["back"] == {"asked": typed["asked"], "box": typed["asked"]}
    assert seen["faceted"]["query"] == seen["faceted"]["box"]
    assert seen["wrong"]["mark"] == "size:big"
    assert "column 6" in seen["wrong"]["told"]
    assert seen["wrong"]["rows"] == 2, "what was found before stays in sight"


def _check_shares(seen: dict[str, Any], terminal: Terminal) -> None:
    assert [row.split("\n")[0] for row in seen["markup"]["rows"]] == [_MARKUP]
    assert seen["markup"]["elements"] == 0
    assert 'mission:"Wet *" topic:/imu/data' in seen["topic"]
    assert {file["path"] for file in terminal.run("file", "list", "--label", "icra 27", "--json").json()["items"]} == {
        "drive.mcap"
    }
    assert seen["shareOfTwo"], "a link shows files of one mission"
    assert seen["shared"]["chosen"], "what is selected is what the link shows"
    assert seen["shared"]["told"].startswith(f"{seen['shared']['place']}\n\n1 file, ")
    assert [row.split()[0] for row in seen["shared"]["rows"]] == ["drive.mcap"]
    assert [row.split("\n")[0] for row in seen["public"]] == ["Lakes"]
    assert {row.split("\n")[-1] for row in seen["publicRows"]} == {"Lakes / night"}
    assert seen["publicBoxes"] == 0, "nothing is to be chosen by people without an account"


def _fetched(seen: dict[str, Any], terminal: Terminal, tmp_path: Path) -> dict[str, bytes]:
    """What the script that was downloaded downloads."""
    assert seen["amount"].startswith("2 files, ")
    script = tmp_path / "download.sh"
    script.write_text(seen["script"])
    path = f"{KLEIN.parent}:{terminal.environment['PATH']}"
    fetched = tmp_path / "fetched"
    subprocess.run(["sh", script, fetched], check=True, env={**terminal.environment, "PATH": path}, timeout=60)
    return {path.relative_to(fetched).as_posix(): path.read_bytes() for path in fetched.rglob("*") if path.is_file()}
