"""Dependencies are locked from an index or a folder of wheels, or refused in one sentence."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from kleinkram.contract.locks import parse_lock
from kleinkram.environments.lock import CannotLock, check_own_lock, lock_dependencies
from kleinkram.environments.uv import parse_index
from tests.package_index import PackageIndex


def lock_from(place: str, *dependencies: str, requires_python: str | None = None) -> str:
    setting = parse_index(place)
    assert setting is not None
    lock = lock_dependencies(dependencies, setting, time.sleep, requires_python=requires_python)
    assert lock is not None
    return lock


def refusal(place: str, *dependencies: str, requires_python: str | None = None) -> str:
    with pytest.raises(CannotLock) as caught:
        lock_from(place, *dependencies, requires_python=requires_python)
    return str(caught.value)


def pins(lock: str) -> dict[str, str]:
    return {package.name: package.version for package in parse_lock(lock)}


def test_packages_are_locked_with_what_they_depend_on(index: PackageIndex) -> None:
    lock = lock_from(index.url, "open-kleinkram", "robot")
    assert pins(lock) == {"robot": "1.0", "arm": "1.0"}
    assert index.url not in lock
    check_own_lock(lock, ["open-kleinkram", "robot"])


def test_a_folder_of_wheels_is_an_index(index: PackageIndex) -> None:
    lock = lock_from(str(index.folder), "robot>=1", "arm")
    assert pins(lock) == {"robot": "1.0", "arm": "1.0"}
    assert index.requests == []
    assert refusal(str(index.folder / "nowhere"), "arm") == (
        f"The folder of wheels {index.folder / 'nowhere'} cannot be read."
    )


def test_nothing_is_locked_for_the_library_alone(index: PackageIndex) -> None:
    setting = parse_index(index.url)
    assert setting is not None
    assert lock_dependencies(["open-kleinkram>=0.1"], setting, time.sleep) is None
    assert index.requests == []


def test_refusals_name_what_is_wrong(index: PackageIndex) -> None:
    index.add_source("sketch", "1.0")
    index.add("modern", "1.0", requires_python=">=3.12")
    index.add("old-model", "1.0", requires=["pydantic<2"])
    index.add("pydantic", "1.10.0")
    index.add("pydantic", "2.12.0")
    assert refusal(index.url, "gripper") == "There is no package gripper in the package index."
    assert refusal(index.url, "arm>3") == "There is no release arm>3 in the package index."
    assert refusal(index.url, "sketch") == "The package sketch==1.0 has no wheel; packages are not built from source."
    assert "The packages do not fit together: " in refusal(index.url, "robot", "arm>=2")
    # The library itself needs a later one.
    assert "old-model" in refusal(index.url, "old-model")
    assert refusal(index.url, "modern") == (
        'modern==1.0 requires Python >=3.12: the header of the script needs requires-python = ">=3.12".'
    )
    assert pins(lock_from(index.url, "modern", requires_python=">=3.12")) == {"modern": "1.0"}
    assert "not a requirement" in refusal(index.url, "--index-url=http://example.org")
    assert "packages come from the package index" in refusal(index.url, "arm @ http://127.0.0.1/arm.whl")
    assert "No version of Python fulfils" in refusal(index.url, "arm", requires_python="<3.9")


def test_an_index_that_is_away_is_reported_soon(index: PackageIndex) -> None:
    started_s = time.monotonic()
    assert refusal("http://127.0.0.1:9/simple", "arm") == "The package index does not answer."
    assert time.monotonic() - started_s < 20
    index.status = 403
    assert refusal(index.url, "arm") == "The package index refuses access (HTTP status 403)."


def test_a_caller_that_is_over_ends_it(index: PackageIndex) -> None:
    class Over(Exception):
        pass

    def wait(_: float) -> None:
        raise Over

    setting = parse_index(index.url)
    assert setting is not None
    with pytest.raises(Over):
        lock_dependencies(["arm"], setting, wait)


def test_settings_of_the_user_do_not_count(
    index: PackageIndex, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UV_DEFAULT_INDEX", "http://127.0.0.1:9/simple")
    monkeypatch.setenv("UV_EXTRA_INDEX_URL", "http://127.0.0.1:9/simple")
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".config" / "uv").mkdir(parents=True)
    (tmp_path / ".config" / "uv" / "uv.toml").write_text('index-url = "http://127.0.0.1:9/simple"\n')
    assert pins(lock_from(index.url, "arm")) == {"arm": "2.0"}


def test_an_own_lock_contains_the_dependencies_and_fits_the_library() -> None:
    pinned = f"arm==1.0 --hash=sha256:{'0' * 64}\n"
    check_own_lock(pinned, ["arm>=1", "open-kleinkram"])
    for lock, dependencies, reason in (
        (pinned, ["arm>=2"], "The lock does not match the dependencies: arm>=2 is locked as arm==1.0."),
        (pinned, ["robot"], "The lock does not match the dependencies: robot is not locked."),
        (pinned.replace("arm==1.0", "pydantic==1.0"), ["pydantic"], "but kleinkram.action needs pydantic"),
    ):
        with pytest.raises(CannotLock) as caught:
            check_own_lock(lock, dependencies)
        assert reason in str(caught.value)
