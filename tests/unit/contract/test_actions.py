"""Definitions of actions: valid forms, and values of parameters."""

import pytest
from pydantic import ValidationError

from kleinkram.contract.actions import ActionDefinition, Parameter, ParameterType, ParameterValue, Resources


def definition(**text: object) -> ActionDefinition:
    return ActionDefinition.model_validate({"name": "check-imu", "image": "lab/check:1", **text})


def test_amounts_are_parsed_with_units() -> None:
    text = Resources.model_validate({"memory": "4GB", "disk": "1.5 GiB", "time": "30m", "cores": 2})
    assert (text.memory_bytes, text.disk_bytes, text.time_s) == (4 * 10**9, 3 * 2**29, 1800)
    assert Resources.model_validate_json(text.model_dump_json()) == text


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ({"image": None}, "requires an 'image' or a 'script'"),
        ({"image": None, "script": "print()", "command": ["ls"]}, "has no 'command'"),
        ({"image": "--privileged"}, "String should match"),
        ({"parameters": [{"name": "a", "type": "string"}] * 2}, "'a' is declared twice"),
        ({"metrics": [{"name": "a"}] * 2}, "the metric 'a' is declared twice"),
        ({"metrics": [{"name": "a", "better": "up"}]}, "'lower', 'higher' or 'none'"),
        ({"metrics": [{"name": "Ä"}]}, "String should match"),
        ({"parameters": [{"name": "a", "type": "choice"}]}, "'choices' are required for a choice"),
        ({"parameters": [{"name": "a", "type": "string", "minimum": 1}]}, "only for integers and numbers"),
        ({"parameters": [{"name": "a", "type": "integer", "default": 1.5}]}, "is a whole number, not 1.5"),
        ({"resources": {"memory": "4 elephants"}}, "write bytes"),
        ({"resources": {"time": "0.5s"}}, "not a whole number"),
        ({"resources": {"cores": 0}}, "greater than 0"),
        ({"network": "host"}, "'none', 'api' or 'open'"),
        ({"privileged": True}, "Extra inputs"),
    ],
)
def test_invalid_actions_are_refused(text: dict[str, object], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        definition(**text)


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (ParameterType.integer, 3, 3.5),
        (ParameterType.integer, -3, True),
        (ParameterType.number, 3, "3"),
        (ParameterType.number, 0.5, float("nan")),
        (ParameterType.boolean, True, 1),
        (ParameterType.string, "", 1),
        (ParameterType.topic, "/imu", None),
    ],
)
def test_values_are_of_their_type(kind: ParameterType, good: ParameterValue, bad: ParameterValue) -> None:
    parameter = Parameter(name="a", type=kind)
    assert parameter.check(good) == good
    with pytest.raises(ValueError, match="'a' is"):
        parameter.check(bad)


def test_values_are_filled_in() -> None:
    action = definition(
        parameters=[
            {"name": "topic", "type": "topic"},
            {"name": "rate", "type": "number", "default": 10, "minimum": 1, "maximum": 100},
            {"name": "mode", "type": "choice", "choices": ["fast", "exact"], "default": "fast"},
        ]
    )
    assert action.fill_in({"topic": "/imu", "mode": "exact"}) == {"topic": "/imu", "rate": 10.0, "mode": "exact"}
    for values, why in (
        ({}, "requires its parameter 'topic'"),
        ({"topic": "/imu", "speed": 1}, "no parameter 'speed'; it has topic, rate, mode"),
        ({"topic": "/imu", "rate": 0.5}, "at least 1"),
        ({"topic": "/imu", "rate": 101}, "at most 100"),
        ({"topic": "/imu", "mode": "slow"}, "one of fast, exact"),
    ):
        with pytest.raises(ValueError, match=why):
            action.fill_in(values)  # type: ignore[arg-type]  # the literal is wider than the values
