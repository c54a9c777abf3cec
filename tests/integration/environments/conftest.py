"""A package index of the test's own, without the proxies of this machine; runners of a fake server that use it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.runner.conftest import docker, podman
from tests.integration.runner_loop.conftest import runners, server
from tests.package_index import PackageIndex, serve_index

__all__ = ["docker", "podman", "runners", "server"]


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[PackageIndex]:
    """An index with the packages `arm` 1.0 and 2.0; `robot` 1.0 depends on `arm` < 2."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with serve_index(tmp_path / "wheels") as made:
        made.add("arm", "1.0")
        made.add("arm", "2.0")
        made.add("robot", "1.0", requires=["arm<2"])
        yield made
