"""`klein runner kubernetes`: its options, and what is wrong with them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from kleinkram.cli import runner as commands
from kleinkram.client.errors import InvalidInput
from kleinkram.runner.arguments import Arguments
from kleinkram.runner.executors.kubernetes.cluster import connect
from kleinkram.runner.executors.kubernetes.options import Toleration


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The commands that were started in place of this process."""
    started: list[list[str]] = []
    monkeypatch.setattr(commands, "_become", started.append)
    return started


def test_options_become_those_of_the_runner(started: list[list[str]], tmp_path: Path) -> None:
    commands.kubernetes(
        namespace="runs",
        url="https://kleinkram.lab.example",
        memory="64GB",
        gpus=2,
        node_selector=["pool=slam"],
        gpu_node_selector=["nvidia.com/gpu.present=true"],
        gpu_toleration=["nvidia.com/gpu:NoSchedule"],
        user=0,
        data_dir=tmp_path,
    )
    options = Arguments.model_validate_json(started[0][-1]).kubernetes
    assert options is not None
    assert (options.memory_bytes, options.gpus, options.run_as_user) == (64 * 10**9, 2, None)
    assert options.node_selector == {"pool": "slam"}
    assert options.gpu_node_selector == {"nvidia.com/gpu.present": "true"}
    assert options.gpu_tolerations == [Toleration(key="nvidia.com/gpu", effect="NoSchedule")]


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"namespace": "Runs"}, "namespace"),
        ({"node_selector": ["slam"]}, "it is KEY=VALUE"),
        ({"toleration": ["gpu:Never"]}, "--toleration"),
    ],
)
def test_wrong_options_are_refused(
    started: list[list[str]], wrong: dict[str, list[str]], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match=sentence):
        commands.kubernetes(url="https://kleinkram.lab.example", data_dir=tmp_path, **wrong)
    assert not started


def test_a_missing_library_and_a_missing_configuration_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match="The configuration of Kubernetes"):
        connect("runs", tmp_path / "kubeconfig")
    monkeypatch.setitem(sys.modules, "kubernetes", None)
    with pytest.raises(InvalidInput, match=r"pip install 'open-kleinkram\[kubernetes\]'"):
        connect("runs")
