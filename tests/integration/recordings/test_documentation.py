"""The pages on recordings name every problem code, and their examples run."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_mcap
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.klein import klein_for_shells
from tests.requirements import need

ROOT = Path(__file__).parents[3]
# What each recipe writes; a recording that can be opened, where it has a known extension.
WRITTEN = {
    "1. Two topics of a local recording": ["motion.mcap"],
    "2. Two seconds of a mission on the server": ["camera.mcap", "slices/field-day/drive.mcap"],
    "3. A ROS 1 bag for ROS 2, and back": [
        "ros2/drive.mcap",
        "ros1/drive.mcap",
        "ros1/drive_rosbag2.bag",
        "repaired/cut.mcap",
    ],
    "4. Tables for pandas": [
        "tables/imu.data.parquet",
        "fixes/gps.fix.csv",
        "odometry/PROJECT/field-day-1/odom.parquet",
        "odometry/PROJECT/field-day-1/odom-2.parquet",
    ],
    "5. Two images a second, for labelling": [
        "images/camera.image.compressed/1714550400000277555.jpg",
        "images/camera.image.compressed/index.csv",
    ],
    "6. With `curl` alone": ["slice.mcap"],
    "Around events": [
        "events.csv",
        "clips/stumble-2024-05-01T08-00-03.000Z.mcap",
        "clips/steep part-2024-05-01T08-00-05.000Z.mcap",
        "slips/slip-2024-05-01T08-00-04.000Z.mcap",
    ],
    "In Python": [
        "imu.mcap",
        "csv/odom.csv",
        "pictures/camera.image.compressed/index.csv",
        "drive.mcap",
        "data/field-day/drive.mcap",
        "all.mcap",
    ],
}
RunBlock = Callable[[str, str], Path]


def test_every_problem_code_is_on_the_page() -> None:
    page = (ROOT / "docs/formats.md").read_text()
    table = page.split("<!-- codes -->")[1].split("<!-- /codes -->")[0]
    listed = re.findall(r"^\| `([a-z-]+)` \|", table, re.MULTILINE)
    assert listed == sorted(set(listed))
    assert set(listed) == set(codes_in_source())


_MAY_MAKE_ONE = re.compile(r"\b(Problem|NotIndexed|problem_log\.add)\(")


def codes_in_source() -> Iterator[str]:
    """Yield the first argument of whatever makes a problem, anywhere in the source."""
    for path in (ROOT / "src/kleinkram").rglob("*.py"):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if _MAY_MAKE_ONE.search(text) else ():
            if isinstance(node, ast.Call) and _makes_a_problem(node) and isinstance(node.args[0], ast.Constant):
                yield str(node.args[0].value)


def _makes_a_problem(call: ast.Call) -> bool:
    if not call.args:
        return False
    name = ast.unparse(call.func)
    if name == "NotIndexed":  # only some of these reach a person
        return any(word.arg == "is_problem" and ast.literal_eval(word.value) for word in call.keywords)
    return name == "Problem" or (name.endswith("problem_log.add") and len(call.args) == 3)


def test_the_reading_guide_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    generate_mcap(tmp_path / "drive.mcap", duration_s=3, size_bytes=11_000_000)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/reading.md").read_text(), re.DOTALL)
    local = [block for block in blocks if "kleinkram.connect()" not in block]
    assert len(local) == len(blocks) - 1
    shared: dict[str, object] = {}
    shown = []
    for block in local:
        exec(block, shared)
        shown.append(capsys.readouterr().out)
    assert all(shown)
    assert "no-footer cut.mcap" in shown[-1]


def recipes() -> dict[str, list[tuple[str, str]]]:
    """Return the language and the text of each block of code below each heading of the page, up to its reference."""
    page = (ROOT / "docs/slices.md").read_text().partition("## Six recipes")[2].partition("\n## Times")[0]
    sections = re.split(r"^##+ (.*)$", page, flags=re.MULTILINE)
    blocks = (re.findall(r"```(bash|python)\n(.*?)```", text, re.DOTALL) for text in sections[::2])
    return dict(zip(["", *sections[1::2]], blocks, strict=True))


@pytest.fixture(name="project", scope="module")
def _project() -> str:
    return f"alpine-{uuid.uuid4().hex[:8]}"


@pytest.fixture(name="run_block", scope="module")
def _run_block(api: Api, project: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunBlock]:
    """A function that runs a block of the page in a folder, which has the files of the page and is returned."""
    folder: Path = tmp_path_factory.mktemp("recipes")
    homes = {f"XDG_{kind}_HOME": str(folder / "home") for kind in ("CONFIG", "STATE", "DATA")}
    known = {"KLEINKRAM_URL": api.url, "KLEINKRAM_TOKEN": str(api.token)}

    def run(language: str, block: str) -> Path:
        text = block.replace("alpine", project).replace("head -c 10000000", "head -c 1000000")
        command = ["bash", "-euo", "pipefail", "-c"] if language == "bash" else [sys.executable, "-W", "error", "-c"]
        done = subprocess.run(
            [*command, text],
            cwd=folder,
            env={**os.environ, **homes, **known, "PATH": path},
            capture_output=True,
            text=True,
            timeout=100,
        )
        assert done.returncode == 0, f"{text}\n{done.stdout}\n{done.stderr}"
        return folder

    ((language, preparation),) = recipes()[""]
    with klein_for_shells() as programs:
        path = f"{programs}:{Path(sys.executable).parent}:{os.environ['PATH']}"
        # No worker runs here; and small recordings suffice.
        run(language, preparation.replace("--wait ", "").replace("sample field-day", "sample field-day --size 6MB"))
        run_jobs(api)
        yield run


def test_each_recipe_of_the_page_is_tested() -> None:
    assert [*recipes()][1:] == [*WRITTEN]


@pytest.mark.parametrize("title", WRITTEN)
def test_the_recipes_run(run_block: RunBlock, project: str, title: str) -> None:
    if "curl" in title:
        need("curl")
    for language, block in recipes()[title]:
        folder = run_block(language, block)
    for name in WRITTEN[title]:
        path = folder / name.replace("PROJECT", project)
        assert path.stat().st_size > 0
        if path.suffix in (".mcap", ".bag"):
            with Recording.open(path) as recording:
                assert recording.message_count
                # The mission has ROS 1 and ROS 2 messages of one topic.
                assert {problem.code for problem in recording.problems} <= {"topic-types-differ"}
