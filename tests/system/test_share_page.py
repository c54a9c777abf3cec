"""The page of a link in a real browser: it shows the link's files, and no text from elsewhere as HTML."""

import subprocess
from pathlib import Path

import pytest

from tests.lacking import need, path_of
from tests.system.house import House


@pytest.fixture
def browser(tmp_path: Path) -> list[str]:
    """The command line that prints a page as it is once its script has run."""
    need("chromium")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=8000", "--dump-dom"]
    return [str(path_of("chromium")), *options, f"--user-data-dir={tmp_path / 'profile'}"]


def _seen(browser: list[str], address: str) -> str:
    done = subprocess.run([*browser, address], capture_output=True, text=True, timeout=100, check=True)
    return done.stdout


@pytest.mark.slow
def test_the_page_shows_what_the_link_shows(house: House, browser: list[str], tmp_path: Path) -> None:
    house.start()
    terminal = house.terminal
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
    assert seen.count("<button") == 3, "one a file, and one for more, which is hidden"
    assert "hidden.bin" not in seen

    terminal.run("share", "revoke", link)
    assert "This link has ended" in _seen(browser, link)
    assert link.partition("#")[2] not in (house.data_dir / "logs").joinpath("api.log").read_text()
