"""The built package contains the web interface."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

from kleinkram.server.http.web_app import BUILT

_ROOT = Path(__file__).parents[3]


def test_wheel_and_sdist_bring_the_app(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", tmp_path], cwd=_ROOT, check=True, capture_output=True
    )
    (wheel,), (sdist,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        in_wheel = {name.partition("/built/")[2] for name in archive.namelist() if "/web/built/" in name}
    with tarfile.open(sdist) as tar:
        names = tar.getnames()
    in_sdist = {name.partition("/built/")[2] for name in names if "/web/built/" in name and not name.endswith("/")}
    built = {path.relative_to(BUILT).as_posix() for path in BUILT.rglob("*") if path.is_file()}
    assert "index.html" in built
    assert in_wheel == built
    assert in_sdist >= built
    assert not any("node_modules" in name for name in names)


def test_nothing_is_built_without_the_app(tmp_path: Path) -> None:
    for name in ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE"):
        (tmp_path / name).write_bytes((_ROOT / name).read_bytes())
    package = tmp_path / "src" / "kleinkram"
    package.mkdir(parents=True)
    (package / "__init__.py").write_bytes((_ROOT / "src" / "kleinkram" / "__init__.py").read_bytes())
    done = subprocess.run([sys.executable, "-m", "hatchling", "build"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode != 0
    assert "make setup" in done.stderr
