"""What results are reused by: the same as before for actions that declare no metadata and no checks."""

import uuid
from typing import NamedTuple

import pytest

from kleinkram.checks.document import read_checks
from kleinkram.contract.actions import ActionDefinition, Inputs
from kleinkram.contract.metadata import Metadata
from kleinkram.server.actions.service import definition_sha256
from kleinkram.server.runs.declared_inputs import DeclaredInputs, declared_inputs
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


PROFILES = "version: 1\nprofiles: [{name: a, when: {place: hall}, reference: /vicon/pose}, {reference: truth.tum}]\n"
RULES, OTHER_RULES = b"\1" * 32, b"\2" * 32


def of(inputs: Inputs, metadata: Metadata, checks_sha256: bytes | None = None) -> str:
    """Return the fingerprint of a run on a mission with these metadata, in a project with `PROFILES`."""
    return fingerprint(declared_inputs(inputs, metadata, checks_sha256, read_checks(PROFILES)))


@pytest.mark.parametrize("other", [{"reference": "/odom"}, {"reference": 1}, {"reference": True}])
def test_every_declared_value_counts(other: Metadata) -> None:
    inputs = Inputs(metadata=["reference"])
    assert of(inputs, {}) != of(inputs, other)
    assert of(inputs, {}) != fingerprint(DeclaredInputs())


def test_results_of_actions_that_declare_metadata_or_checks_stay_valid() -> None:
    expected = "509023f6b4b11a4fd9518be0feec7c97f8062c6b9e75b4ba772c92d90d63aeb5"
    assert of(Inputs(metadata=["reference"]), {"reference": "/odom", "robot": "spot"}, RULES) == expected
    expected = "7ab92cf7bea4e04d04e4e8dc41fcee71a3300052924fb649dea58520bc6fe232"
    assert of(Inputs(checks=True), {"robot": "spot"}, RULES) == expected


def test_with_checks_all_metadata_and_all_rules_count() -> None:
    for inputs in (Inputs(checks=True), Inputs(checks=True, reference=True)):
        spot = of(inputs, {"robot": "spot"}, RULES)
        assert len({spot, *(of(inputs, {}, sha256) for sha256 in (RULES, OTHER_RULES, None))}) == 4


def test_of_metadata_and_checks_only_the_reference_counts() -> None:
    reading = Inputs(reference=True)
    others = of(reading, {}, RULES)
    assert others == of(reading, {"robot": "spot"}, OTHER_RULES) == of(reading, {"reference": "truth.tum"}, RULES)
    assert others != of(reading, {"place": "hall"}, RULES)
    assert of(reading, {"place": "hall"}, RULES) == of(reading, {"reference": "/vicon/pose"}, RULES)
    assert fingerprint(declared_inputs(reading, {}, None, None)) != others
    naming = Inputs(reference=True, metadata=["robot"])
    assert of(naming, {"robot": "spot"}, RULES) != of(naming, {"robot": "anymal", "place": "lab"}, RULES)
    assert of(naming, {"robot": "spot"}, RULES) == of(naming, {"robot": "spot", "place": "lab"}, OTHER_RULES)


@pytest.mark.parametrize("inputs", [Inputs(metadata=["reference"]), Inputs(checks=True), Inputs(reference=True)])
def test_what_is_declared_makes_another_definition(inputs: Inputs) -> None:
    plain = ActionDefinition(name="count", script="print('hello')\n")
    declaring = plain.model_copy(update={"inputs": inputs})
    assert definition_sha256(plain, is_to_lock=False) != definition_sha256(declaring, is_to_lock=False)
