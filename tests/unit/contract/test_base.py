"""Models that are made without validation, because there are very many."""

import copy
import pickle

import pytest
from pydantic import ValidationError

from kleinkram.contract.base import construct
from kleinkram.contract.checks import Check, CheckStatus, MissionCheck


def test_a_constructed_model_is_like_a_validated_one() -> None:
    values = dict.fromkeys(Check.model_fields) | {"name": "topic.gap", "status": CheckStatus.error, "message": "3 s"}
    valid = Check.model_validate(values)
    made = construct(Check, dict(values))
    assert (made, hash(made), made.model_dump_json()) == (valid, hash(valid), valid.model_dump_json())
    assert [copy.copy(made), copy.deepcopy(made), pickle.loads(pickle.dumps(made))] == [valid] * 3
    assert made.model_copy(update={"topic": "/imu"}) == valid.model_copy(update={"topic": "/imu"})
    assert made.model_dump(exclude_unset=True) == valid.model_dump(exclude_unset=True), "as requests are sent"
    assert made.model_dump(exclude_defaults=True) == valid.model_dump(exclude_defaults=True)
    assert repr(made) == repr(valid)
    with pytest.raises(ValidationError):
        made.topic = "/imu"  # type: ignore[misc]  # frozen
    assert isinstance(MissionCheck.model_validate(made.model_dump()), MissionCheck)
