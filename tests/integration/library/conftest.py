"""A lab whose package index has evo, but not kiss-icp."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from kleinkram.action import testing
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.runs.conftest import place, runner
from tests.klein import run_script
from tests.package_index import PackageIndex, serve_index

__all__ = ["place", "runner"]


@pytest.fixture(scope="module", autouse=True)
def _forked_scripts() -> Iterator[None]:
    """Fork what `try_out` runs: Python and the imports of a script take longer than most of these missions."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(testing, "_run_script", run_script)
        yield


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PackageIndex]:
    """The index, without the proxies of this machine."""
    before = os.environ.get("NO_PROXY")
    os.environ["NO_PROXY"] = "127.0.0.1"
    with serve_index(tmp_path_factory.mktemp("wheels")) as made:
        made.add("evo", "1.38.1")
        yield made
    del os.environ["NO_PROXY"]
    if before is not None:
        os.environ["NO_PROXY"] = before


@pytest.fixture(scope="module")
def lab(start_api: StartApi, index: PackageIndex) -> Api:
    return start_api(package_index=index.url)


@pytest.fixture
def project_id(lab: Api) -> str:
    return str(lab.project()["id"])
