"""Accounts of Slurm: budgets that are used up, accounts that do not exist, and what the accounting has about a run."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.slurm.commands import SlurmCommands
from kleinkram.runner.executors.slurm.options import SlurmOptions
from kleinkram.runner.executors.slurm.probe import find_site
from tests import slurm_accounts, slurm_cluster
from tests.integration.runner_loop.conftest import Runners, ended
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.runner_loop.test_slurm import until_shown
from tests.requirements import need
from tests.slurm_cluster import SlurmCluster

# The database alone takes some seconds to begin.
pytestmark = [pytest.mark.slow, pytest.mark.soak]


@pytest.fixture(scope="module")
def accounted() -> Iterator[SlurmCluster]:
    """A cluster with accounts."""
    need(*slurm_cluster.PROGRAMS, *slurm_accounts.PROGRAMS)
    with slurm_cluster.slurm_cluster(has_accounting=True) as made:
        yield made


@pytest.fixture(autouse=True)
def known(accounted: SlurmCluster, runners: Runners, tmp_path: Path) -> None:
    """Have runners know the cluster."""
    runners.folder.mkdir()
    find_site(SlurmCommands(accounted.environment), SlurmOptions(1, account="rich"), tmp_path, runner="tests")
    shutil.copy(tmp_path / "slurm-site.json", runners.folder)


def test_a_run_waits_while_the_budget_of_its_account_is_used_up(
    server: FakeServer, runners: Runners, accounted: SlurmCluster
) -> None:
    runners.spawn(slurm=accounted, account="poor")
    run = server.launch("sum(range(10**7))")
    until_shown(run, "waits in Slurm: the budget of its account is used up (AssocGrpCPUMinutesLimit)")
    accounted.set_budget("poor", -1)
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.done
    assert finish.placement is not None
    assert finish.placement.cpu_s, "sacct has it"
    assert finish.placement.peak_memory_bytes


def test_an_account_that_does_not_exist_is_refused(
    server: FakeServer, runners: Runners, accounted: SlurmCluster, tmp_path: Path
) -> None:
    """A runner does not start with one; where its account is removed later, runs wait until somebody notices."""
    words = "Invalid account or account/partition combination specified"
    folder = tmp_path / "new"
    folder.mkdir()
    with pytest.raises(InvalidInput, match=words):
        find_site(SlurmCommands(accounted.environment), SlurmOptions(1, account="ghost"), folder, runner="tests")
    runners.spawn(slurm=accounted, account="ghost")
    run = server.launch("print('began')")
    until_shown(run, f"waits for Slurm: {words}")
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled
