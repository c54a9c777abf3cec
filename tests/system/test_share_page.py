"""The page of a share in a real browser shows its files, and escapes text from elsewhere."""

import base64
import subprocess
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import wait_until
from tests.requirements import need_browser
from tests.system.cluster import Cluster

_PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


@pytest.fixture
def browser(tmp_path: Path) -> list[str]:
    """The command line that prints the document of a page after its script has run."""
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=8000", "--dump-dom"]
    return [need_browser(), *options, f"--user-data-dir={tmp_path / 'profile'}"]


def _seen(browser: list[str], address: str) -> str:
    done = subprocess.run([*browser, address], capture_output=True, text=True, timeout=100, check=True)
    return done.stdout


@pytest.mark.slow
def test_the_share_page_shows_only_the_shared_files(
    shared_cluster: Cluster, browser: list[str], tmp_path: Path
) -> None:
    terminal = shared_cluster.terminal
    folder = tmp_path / "day"
    folder.mkdir()
    for name, size in (("<b>bold<b>.bin", 1500), ("plain.bin", 20), ("hidden.bin", 5)):
        (folder / name).write_bytes(b"x" * size)
    terminal.run("project", "create", "Alps")
    terminal.run("upload", "-p", "Alps", "-m", "Day & night", "--create", f"{folder}/")
    place = ["-p", "Alps", "-m", "Day & night"]
    link = terminal.run("share", "create", "plain.bin", "<b>bold<b>.bin", *place).out.strip()

    seen = _seen(browser, link)
    assert "Alps / Day &amp; night" in seen
    assert "2 files, 1.5 kB" in seen
    assert "&lt;b&gt;bold&lt;b&gt;.bin" in seen
    assert seen.count("<button") == 4, "a button per file, one for all files, and a hidden one for more files"
    assert "Download all (1.5 kB)" in seen
    assert f"klein download '{link}'" in seen
    assert "hidden.bin" not in seen

    terminal.run("share", "revoke", link)
    assert "This link has ended" in _seen(browser, link)
    assert link.partition("#")[2] not in (shared_cluster.data_dir / "logs").joinpath("api.log").read_text()


@pytest.mark.slow
def test_the_share_page_of_a_mission_shows_metadata_topics_and_a_picture(
    shared_cluster: Cluster, browser: list[str], tmp_path: Path
) -> None:
    terminal = shared_cluster.terminal
    folder = tmp_path / "day"
    folder.mkdir()
    generate_mcap(folder / "drive.mcap", duration_s=5)
    (folder / "preview.png").write_bytes(_PIXEL)
    (tmp_path / "said.yaml").write_text("robot: <i>anymal</i>\nsite: {latitude: 47.0, longitude: 8.5}\n")
    terminal.run("project", "create", "Jura")
    place = ["-p", "Jura", "-m", "Day"]
    terminal.run("upload", *place, "--create", "--metadata", tmp_path / "said.yaml", f"{folder}/", "--wait")

    link = terminal.run("share", "create", *place).out.strip()
    seen = _seen(browser, link)
    assert f'href="/s/view#{link.partition("#")[2]}"' in seen, "a link to the viewer"
    wait_until(lambda: 'alt="Picture of a camera"' in _seen(browser, link), "the thumbnail of the recording")
    assert "&lt;i&gt;anymal&lt;/i&gt;" in seen
    assert "47, 8.5" in seen
    assert "/imu/data" in seen
    assert "sensor_msgs/msg/Imu" in seen
    assert 'alt="preview.png"' in seen

    some = _seen(browser, terminal.run("share", "create", "preview.png", *place).out.strip())
    assert "anymal" not in some, "a link to some files shows no metadata of the mission"
    assert "/imu/data" not in some
    assert "/s/view" not in some, "a picture is no recording"
