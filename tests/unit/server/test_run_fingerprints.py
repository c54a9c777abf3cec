"""What results are reused by: the same as before for actions that declare no metadata and no checks."""

import uuid
from typing import NamedTuple

import pytest

from kleinkram.contract.actions import ActionDefinition, Inputs
from kleinkram.server.actions.service import definition_sha256
from kleinkram.server.runs.declared_inputs import DeclaredInputs
from kleinkram.server.runs.launch import inputs_fingerprint


class _File(NamedTuple):
    path: str
    sha256: bytes


def fingerprint(declared: DeclaredInputs) -> str:
    return inputs_fingerprint(uuid.UUID(int=7), {"rate": 10}, [_File("drive.mcap", b"\1" * 32)], declared).hex()


def test_results_from_before_declared_inputs_stay_valid() -> None:
    expected = "ba9b56d030a9d7740d0780dc0826dcd081961c3472c2019c59c7744b23a81b0c"
    assert fingerprint(DeclaredInputs()) == expected
    definition = ActionDefinition(name="count", script="print('hello')\n", inputs=Inputs(paths=["*.mcap"]))
    assert (
        definition_sha256(definition, is_to_lock=False).hex()
        == "e9119f18e4d068407031189125b9bbbbc4798981bea10521d0ff47d2ff3a8de9"
    )


@pytest.mark.parametrize(
    "other",
    [
        DeclaredInputs(),
        DeclaredInputs({"reference": "/odom"}),
        DeclaredInputs({"reference": 1}),
        DeclaredInputs({"reference": True}),
        DeclaredInputs({}, b"\2" * 32),
    ],
)
def test_every_declared_value_counts(other: DeclaredInputs) -> None:
    assert fingerprint(DeclaredInputs({})) != fingerprint(other)


@pytest.mark.parametrize("inputs", [Inputs(metadata=["reference"]), Inputs(checks=True)])
def test_what_is_declared_makes_another_definition(inputs: Inputs) -> None:
    plain = ActionDefinition(name="count", script="print('hello')\n")
    declaring = plain.model_copy(update={"inputs": inputs})
    assert definition_sha256(plain, is_to_lock=False) != definition_sha256(declaring, is_to_lock=False)
