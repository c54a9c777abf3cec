"""The options of `klein runner slurm`."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.cli import runner
from kleinkram.runner.arguments import Arguments
from kleinkram.runner.executors.slurm.options import SlurmOptions


def test_a_runner_on_slurm_gets_its_options(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    commands: list[list[str]] = []
    monkeypatch.setattr(runner, "_become", commands.append)
    runner.slurm(
        partition="gpu",
        account="lab",
        max_jobs=5,
        sbatch_option=["reservation=night", "--comment=a=b", "spread-job"],
        allow_option=["--nice", "licenses"],
        url="https://kleinkram.lab.example",
        name="cluster",
        label=["cluster"],
        data_dir=tmp_path,
    )
    (command,) = commands
    arguments = Arguments.model_validate_json(command[-1])
    assert (arguments.url, arguments.name, arguments.labels) == (
        "https://kleinkram.lab.example",
        "cluster",
        ["cluster"],
    )
    assert arguments.slurm == SlurmOptions(
        max_jobs=5,
        partition="gpu",
        account="lab",
        extra={"reservation": "night", "comment": "a=b", "spread-job": ""},
        allowed=frozenset({"nice", "licenses"}),
    )
