"""Environments are built once, whole or not at all, and kept while they are used."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from kleinkram.environments import cache as cache_module
from kleinkram.environments.cache import (
    CannotInstall,
    Environment,
    EnvironmentCache,
    EnvironmentRequest,
    compile_packages,
)
from kleinkram.environments.lock import lock_dependencies
from kleinkram.environments.python import PROBE, Python, parse_python
from kleinkram.environments.uv import Wait, parse_index
from tests.package_index import PackageIndex

GB = 10**9


def this_python() -> Python:
    done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, check=True)
    return parse_python(done.stdout)


def lock_of(index: PackageIndex, *dependencies: str) -> str:
    setting = parse_index(index.url)
    assert setting is not None
    lock = lock_dependencies(dependencies, setting, time.sleep)
    assert lock is not None
    return lock


def a_cache(folder: Path, index: PackageIndex, limit_bytes: int = GB) -> EnvironmentCache:
    setting = parse_index(index.url)
    assert setting is not None
    return EnvironmentCache(folder / "environments", setting, limit_bytes)


def get(
    cache: EnvironmentCache, lock: str, shown: list[str] | None = None, requires_python: str | None = None
) -> Environment:
    return cache.get(
        EnvironmentRequest(lock, this_python(), requires_python),
        wait=time.sleep,
        show=lambda message, _: None if shown is None else shown.append(message),
        compile_in=lambda folder, wait: compile_packages(sys.executable, folder, wait),
    )


def imported(environment: Environment, code: str) -> str:
    command = [sys.executable, "-I", "-c", f"import sys; sys.path.insert(0, {str(environment.packages)!r}); {code}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_an_environment_has_what_is_locked_compiled_and_read_only(index: PackageIndex, tmp_path: Path) -> None:
    shown: list[str] = []
    environment = get(a_cache(tmp_path, index), lock_of(index, "robot"), shown)
    assert imported(environment, "import robot, arm; print(robot.VERSION, arm.VERSION)") == "1.0 1.0"
    assert set(shown) == {"Installing 2 packages"}
    assert list(environment.packages.glob("__pycache__/arm.*.pyc"))
    for path in (environment.packages, *environment.packages.rglob("*")):
        assert path.stat().st_mode & 0o222 == 0 or path.parent.name == "__pycache__", path
    environment.close()


def test_a_cached_environment_asks_for_nothing(index: PackageIndex, tmp_path: Path) -> None:
    lock = lock_of(index, "arm")
    get(a_cache(tmp_path, index), lock).close()
    index.requests.clear()
    shown: list[str] = []
    get(a_cache(tmp_path, index), lock, shown).close()
    assert (index.requests, shown) == ([], [])


def test_packages_for_other_platforms_are_left_out(index: PackageIndex, tmp_path: Path) -> None:
    index.add("shell", "1.0", requires=["arm; sys_platform == 'win32'"])
    shown: list[str] = []
    environment = get(a_cache(tmp_path, index), lock_of(index, "shell"), shown)
    assert set(shown) == {"Installing 1 package"}
    assert not (environment.packages / "arm.py").exists()


def test_two_at_once_build_it_once(index: PackageIndex, tmp_path: Path) -> None:
    lock = lock_of(index, "arm")
    index.requests.clear()
    index.delay_s = 0.5
    got: list[Environment] = []
    threads = [threading.Thread(target=lambda: got.append(get(a_cache(tmp_path, index), lock))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {environment.packages for environment in got} == {got[0].packages}
    assert (len(got), len(index.downloads())) == (3, 1)


_BUILD = """\
import sys, time
from pathlib import Path
from kleinkram.environments.uv import parse_index
from tests.package_index import PackageIndex
from tests.integration.environments.test_cache import a_cache, get
get(a_cache(Path(sys.argv[1]), PackageIndex(Path("unused"), sys.argv[2])), Path(sys.argv[3]).read_text())
"""


def test_a_killed_build_leaves_nothing_that_is_used(index: PackageIndex, tmp_path: Path) -> None:
    lock = lock_of(index, "robot")
    (tmp_path / "lock").write_text(lock)
    index.requests.clear()
    index.delay_s = 3
    command = [sys.executable, "-c", _BUILD, str(tmp_path), index.url, str(tmp_path / "lock")]
    with subprocess.Popen(command, cwd=Path(__file__).parents[3]) as process:
        until_s = time.monotonic() + 60
        while not index.downloads():
            assert time.monotonic() < until_s
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    assert not list((tmp_path / "environments").glob("*/complete.json"))
    index.delay_s = 0
    environment = get(a_cache(tmp_path, index), lock)
    assert imported(environment, "import robot, arm; print(robot.VERSION, arm.VERSION)") == "1.0 1.0"
    # What the killed build left is gone.
    assert not list((tmp_path / "environments").glob("*.new-*"))


def test_a_damaged_environment_is_built_again(index: PackageIndex, tmp_path: Path) -> None:
    lock, cache = lock_of(index, "arm"), a_cache(tmp_path, index)
    environment = get(cache, lock)
    environment.close()
    environment.packages.chmod(0o755)
    (environment.packages / "arm.py").unlink()
    assert imported(get(cache, lock), "import arm; print(arm.VERSION)") == "2.0"


def test_files_that_differ_from_the_lock_are_refused(index: PackageIndex, tmp_path: Path) -> None:
    lock, cache = lock_of(index, "arm"), a_cache(tmp_path, index)
    index.add("arm", "2.0", {"arm.py": "VERSION = 'another'\n"})
    with pytest.raises(
        CannotInstall, match=r"The files of arm\S* in the package index do not have the hash of the lock"
    ):
        get(cache, lock)
    assert not list((tmp_path / "environments").glob("*.new-*"))


def test_failures_name_their_reason(index: PackageIndex, tmp_path: Path) -> None:
    lock, cache = lock_of(index, "arm"), a_cache(tmp_path, index)
    with pytest.raises(CannotInstall, match=r"The script requires Python >=3\.99; it would run with 3\."):
        get(cache, lock, requires_python=">=3.99")
    index.status = 503
    with pytest.raises(CannotInstall, match="The package index does not answer"):
        get(cache, lock)


def test_an_environment_beyond_the_limit_is_refused(index: PackageIndex, tmp_path: Path) -> None:
    index.add("large", "1.0", {"large.py": "#" * 100_000})
    cache = a_cache(tmp_path, index, limit_bytes=50_000)
    with pytest.raises(CannotInstall, match=r"They need 0\.0 GB; 0\.0 GB are allowed"):
        get(cache, lock_of(index, "large"))
    assert not [path for path in (tmp_path / "environments").iterdir() if path.is_dir()]


def test_a_caller_that_is_over_ends_the_build(index: PackageIndex, tmp_path: Path) -> None:
    class Over(Exception):
        pass

    def wait(_: float) -> None:
        if index.downloads():
            raise Over

    lock = lock_of(index, "arm")
    index.requests.clear()
    index.delay_s = 30
    started_s = time.monotonic()
    with pytest.raises(Over):
        a_cache(tmp_path, index).get(
            EnvironmentRequest(lock, this_python()), wait=wait, show=lambda *_: None, compile_in=lambda *_: None
        )
    assert time.monotonic() - started_s < 25
    assert not list((tmp_path / "environments").glob("*.new-*"))


def test_the_least_recently_used_one_is_removed_unless_it_is_in_use(index: PackageIndex, tmp_path: Path) -> None:
    for name in ("first", "second", "third", "fourth"):
        index.add(name, "1.0", {f"{name}.py": "#" * 100_000})
    cache = a_cache(tmp_path, index, limit_bytes=250_000)
    used = get(cache, lock_of(index, "first"))
    get(cache, lock_of(index, "second")).close()
    os.utime(used.packages.parent / "complete.json", (0, 0))
    get(cache, lock_of(index, "third")).close()
    packages = {path.name for path in (tmp_path / "environments").glob("*/packages/*.py")}
    # The first was used longest ago, and is in use.
    assert packages == {"first.py", "third.py"}
    used.close()
    os.utime(used.packages.parent / "complete.json", (0, 0))
    get(cache, lock_of(index, "fourth")).close()
    packages = {path.name for path in (tmp_path / "environments").glob("*/packages/*.py")}
    assert packages == {"third.py", "fourth.py"}
    assert len(list((tmp_path / "environments").glob("*.lock"))) == 2


def test_a_python_is_described_by_its_own_words() -> None:
    facts = {"implementation": "cpython", "version": "3.12.4", "machine": "aarch64", "system": "linux"}
    facts |= {"libc": "glibc", "libc_version": "2.41"}
    python = parse_python("a warning\n" + json.dumps(facts | {"free_threaded": False}))
    assert python == Python("3.12.4", "aarch64-manylinux_2_40")
    assert python.markers()["platform_machine"] == "aarch64"


def test_an_image_writes_to_no_environment_but_its_own(index: PackageIndex, tmp_path: Path) -> None:
    """An image compiles the packages, so it could change them: for its own runs only."""
    lock, cache = lock_of(index, "arm"), a_cache(tmp_path, index)

    def compile_in(folder: Path, _: Wait) -> None:
        (folder / "arm.py").chmod(0o644)
        (folder / "arm.py").write_text("VERSION = 'changed'\n")

    def get_for(image: str | None) -> Environment:
        request = EnvironmentRequest(lock, this_python(), image=image)
        compile_it = compile_in if image == "sha256:evil" else lambda *_: None
        return cache.get(request, wait=time.sleep, show=lambda *_: None, compile_in=compile_it)

    assert imported(get_for("sha256:evil"), "import arm; print(arm.VERSION)") == "changed"
    for image in (None, "sha256:good"):
        assert imported(get_for(image), "import arm; print(arm.VERSION)") == "2.0"
    assert get_for("sha256:good").packages == get_for("sha256:good").packages


def test_a_build_that_grows_without_end_is_stopped(
    index: PackageIndex, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache_module, "_MEASURE_EVERY_S", 0.0)
    written = 0

    def compile_in(folder: Path, wait: Wait) -> None:
        nonlocal written
        while written < 100:
            (folder / f"{written}.pyc").write_bytes(bytes(100_000))
            written += 1
            wait(0)

    cache = a_cache(tmp_path, index, limit_bytes=1_000_000)
    request = EnvironmentRequest(lock_of(index, "arm"), this_python())
    with pytest.raises(CannotInstall, match="GB are allowed"):
        cache.get(request, wait=time.sleep, show=lambda *_: None, compile_in=compile_in)
    assert written < 30
    assert not list((tmp_path / "environments").glob("*.new-*"))


@pytest.mark.parametrize(
    "name", ["../../../../stray", "stray-1.0.data/data/../../../stray", "stray-1.0.data/scripts/../../../stray"]
)
def test_no_file_of_a_wheel_is_placed_elsewhere(index: PackageIndex, tmp_path: Path, name: str) -> None:
    index.add("stray", "1.0", {"stray.py": "", name: "here\n"})
    get(a_cache(tmp_path / "one" / "two" / "three", index), lock_of(index, "stray"))
    assert not [path for path in tmp_path.rglob("stray") if path.is_file()]


def test_no_command_of_a_wheel_is_placed_elsewhere(index: PackageIndex, tmp_path: Path) -> None:
    points = {"stray-1.0.dist-info/entry_points.txt": "[console_scripts]\n../../../../stray = stray:main\n"}
    index.add("stray", "1.0", {"stray.py": "", **points})
    with pytest.raises(CannotInstall, match="uv failed"):
        get(a_cache(tmp_path / "one" / "two" / "three", index), lock_of(index, "stray"))
    assert not list(tmp_path.rglob("stray"))
