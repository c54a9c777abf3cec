"""Random histories of uploads and blobs make only the transitions of `docs/states.md`."""

import inspect
import os
import traceback
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.files import BlobState
from kleinkram.contract.uploads import UploadState
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.uploads.faults import FAULTS, Fault, live, planted
from tests.integration.uploads.server_access import SiteThread
from tests.integration.uploads.state_machine import Machine, documented


@pytest.fixture(name="machine", scope="module")
def _machine(start_api: StartApi) -> Iterator[type[Machine]]:
    """The machine on an API of its own."""
    api: Api = start_api(garbage_grace_s=0)
    site = SiteThread(api)
    yield type("MachineHere", (Machine,), {"api": api, "context": site})
    site.close()


def test_the_states_page_names_every_state() -> None:
    for heading, states in (("An upload", UploadState), ("A blob", BlobState)):
        assert {state for edge in documented(heading) for state in edge} == {item.value for item in states}


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


def _found_by(machine: type[Machine], fault: Fault) -> str | None:
    """Live through the fault's history, and return which rule, invariant or look found something wrong, if any did."""
    try:
        live(machine(), fault.history)
    except (AssertionError, IntegrityError) as found:
        frames = traceback.extract_tb(found.__traceback__)
        return [frame.name for frame in frames if frame.filename == inspect.getfile(Machine)][-1]
    return None


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS, ids=[fault.name for fault in FAULTS])
def test_an_injected_fault_is_detected(machine: type[Machine], fault: Fault) -> None:
    assert _found_by(machine, fault) is None, "nothing is wrong before"
    with planted(fault):
        assert _found_by(machine, fault) == fault.found_by


@pytest.mark.soak
def test_long_histories_of_uploads_and_blobs(machine: type[Machine]) -> None:
    _live(machine, examples=int(os.environ.get("KLEINKRAM_SOAK_ROUNDS", "300")), steps=60)
