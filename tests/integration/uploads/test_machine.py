"""Uploads and blobs through random histories: `docs/states.md` is all that ever happens to them."""

from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

from kleinkram.contract.files import BlobState
from kleinkram.contract.uploads import UploadState
from tests.integration.conftest import StartApi
from tests.integration.running import Api
from tests.integration.uploads.machine import Machine, SiteThread, documented


@pytest.fixture(name="machine", scope="module")
def _machine(start_api: StartApi) -> Iterator[type[Machine]]:
    """The machine on an API of its own."""
    api: Api = start_api(sweep_grace_s=0, part_url_s=1)
    site = SiteThread(api)
    yield type("MachineHere", (Machine,), {"api": api, "site": site})
    site.close()


def test_the_page_names_every_state() -> None:
    for heading, states in (("An upload", UploadState), ("A blob", BlobState)):
        assert {state for edge in documented(heading) for state in edge} == {each.value for each in states}


def _live(machine: type[Machine], *, examples: int, steps: int) -> None:
    checks = [HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large]
    how = settings(
        max_examples=examples, stateful_step_count=steps, deadline=None, suppress_health_check=checks, database=None
    )
    run_state_machine_as_test(machine, settings=how)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_histories_of_uploads_and_blobs(machine: type[Machine]) -> None:
    _live(machine, examples=4, steps=20)


@pytest.mark.soak
def test_long_histories_of_uploads_and_blobs(machine: type[Machine]) -> None:
    _live(machine, examples=300, steps=60)
