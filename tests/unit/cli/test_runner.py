"""The options of `klein runner start` and `klein runner slurm`."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.cli import runner
from kleinkram.cli.runner_options import ExecutorOption, ImagesOption
from kleinkram.client.errors import InvalidInput
from kleinkram.runner.arguments import Arguments, ExecutorChoice, ImageChoice
from kleinkram.runner.executors.slurm.options import SlurmOptions

_URL = "https://kleinkram.lab.example"


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The commands that were started in place of this process."""
    commands: list[list[str]] = []
    monkeypatch.setattr(runner, "_become", commands.append)
    return commands


def test_a_runner_of_this_machine_gets_its_options(commands: list[list[str]], tmp_path: Path) -> None:
    runner.start(
        url=_URL,
        name="desk",
        label=["lab"],
        memory="8GB",
        cache="1TB",
        cache_age=30,
        gpu=["GPU-1"],
        gpu_sharing=2,
        executor=ExecutorOption.process,
        images=ImagesOption.auto,
        image_cache="100GB",
        registry=["registry.lab.example"],
        data_dir=tmp_path,
        as_json=True,
    )
    arguments = Arguments.model_validate_json(commands[0][-1])
    assert arguments == Arguments(
        url=_URL,
        name="desk",
        labels=["lab"],
        data_dir=tmp_path,
        memory_bytes=8 * 10**9,
        cache_bytes=10**12,
        cache_age_days=30,
        gpu_names=["GPU-1"],
        gpu_sharing=2,
        executor=ExecutorChoice.process,
        images=ImageChoice.auto,
        images_bytes=100 * 10**9,
        registries=["registry.lab.example"],
        log_format="json",
    )


def test_a_runner_on_slurm_gets_its_options(commands: list[list[str]], tmp_path: Path) -> None:
    runner.slurm(
        partition="gpu",
        account="lab",
        max_jobs=5,
        sbatch_option=["reservation=night", "--comment=a=b", "spread-job"],
        allow_option=["--nice", "licenses"],
        url=_URL,
        name="cluster",
        label=["cluster"],
        data_dir=tmp_path,
    )
    arguments = Arguments.model_validate_json(commands[0][-1])
    assert (arguments.url, arguments.name, arguments.labels) == (_URL, "cluster", ["cluster"])
    assert arguments.slurm == SlurmOptions(
        max_jobs=5,
        partition="gpu",
        account="lab",
        extra={"reservation": "night", "comment": "a=b", "spread-job": ""},
        allowed=frozenset({"nice", "licenses"}),
    )


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"gpus": "many"}, "--gpus"),
        ({"gpus": "1", "gpu": ["GPU-1"]}, "--gpu chooses the GPUs already"),
        ({"label": ["two\nlines"]}, r"The runner \(labels 0\)"),
    ],
)
def test_wrong_options_are_refused(
    commands: list[list[str]], wrong: dict[str, object], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match=sentence):
        runner.start(url=_URL, name="desk", data_dir=tmp_path, **wrong)
    assert not commands
