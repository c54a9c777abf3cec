"""The matrix: every operation, by everybody, at every level on the project and on the mission."""

import random
from collections.abc import Sequence

import pytest

from kleinkram.server.access.operations import OPERATIONS
from tests.integration.access import world as worlds
from tests.integration.access.callers import CALLERS, Caller, Request
from tests.integration.access.carriers import MEMBER, PLACED
from tests.integration.access.expecting import About, Verdict, admitted, level, needed
from tests.integration.access.world import Asker, World
from tests.integration.conftest import StartApi

# The short round: so many places of the plain member an operation, and one of so many of everybody else.
_MEMBERS, _PLACES_EACH = 12, 4


@pytest.fixture(scope="module")
def world(start_api: StartApi) -> World:
    return worlds.build(start_api(), places_each=_PLACES_EACH)


@pytest.fixture(scope="module")
def whole_world(start_api: StartApi) -> World:
    return worlds.build(start_api())


def _wrong(world: World, operation: str, caller: Caller, by: Asker) -> str | None:
    """Make one request, and return what is wrong with its answer."""
    asked = caller.request(by)
    answer = world.api.as_(None).call(asked.method, asked.path, asked.body, asked.query, by.headers)
    verdict, expected = caller.verdict(answer), _expected(operation, caller, by, asked)
    if answer.status < 300 and caller.undo is not None:
        caller.undo(world.api, by)
    if verdict is not expected:
        return f"{by.named}: {verdict}, not {expected.value} ({answer.body})"
    if caller.shows is not None and verdict is Verdict.done:
        is_seen = level(by.carrier, by.place, caller.about) >= needed(OPERATIONS[operation])
        if caller.shows(answer.body, by) != is_seen:
            return f"{by.named}: is {'not shown it' if is_seen else 'shown it'}"
    return None


def _expected(operation: str, caller: Caller, by: Asker, asked: Request) -> Verdict:
    need = OPERATIONS[operation]
    at_the_door = admitted(need, by.carrier, is_change=asked.method != "GET")
    if at_the_door is Verdict.done and caller.is_boundless and by.carrier.is_limited:
        return Verdict.refused
    if at_the_door is not Verdict.done or caller.about is About.server or caller.shows is not None:
        return at_the_door
    held = level(by.carrier, by.place, caller.about)
    if held >= needed(need):
        return Verdict.done
    return Verdict.unseen if held == 0 or caller.hides else Verdict.refused


def _some(world: World, operation: str) -> Sequence[Asker]:
    """Return everybody, in few places; which ones differs between operations."""
    rng = random.Random(operation)
    chosen = [by for by in world.askers if by.carrier not in PLACED]
    for carrier in PLACED:
        everywhere = [by for by in world.askers if by.carrier is carrier]
        chosen += rng.sample(everywhere, _MEMBERS if carrier is MEMBER else 1)
    return chosen


@pytest.mark.parametrize("operation", sorted(CALLERS))
def test_operation(world: World, operation: str) -> None:
    """Each operation answers some of each kind of asker as the rule says."""
    found = [_wrong(world, operation, caller, by) for caller in CALLERS[operation] for by in _some(world, operation)]
    assert [each for each in found if each] == []


@pytest.mark.slow
@pytest.mark.parametrize("operation", sorted(CALLERS))
def test_operation_in_full(whole_world: World, operation: str) -> None:
    """Each operation answers everybody as the rule says, wherever they are."""
    askers = whole_world.askers
    found = [_wrong(whole_world, operation, caller, by) for caller in CALLERS[operation] for by in askers]
    assert [each for each in found if each] == []
