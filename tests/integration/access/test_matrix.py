"""The matrix: every operation by every caller at every level on the project and on the mission."""

import random
from collections.abc import Callable, Sequence

import pytest

from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from tests.integration.access import world as worlds
from tests.integration.access.call import Caller, Request
from tests.integration.access.callers import CALLERS, PUBLIC_OPERATIONS
from tests.integration.access.credentials import MEMBER, PLACED, UNPLACED
from tests.integration.access.expectations import About, Verdict, admitted, level, needed
from tests.integration.access.world import Principal, World
from tests.integration.conftest import StartApi

# The short round asks an operation for so many of each: places of the plain member, others who are somewhere, others.
_MEMBERS, _PLACED, _UNPLACED = 8, 14, 5
# The places that somebody else is in, in the short round.
_PLACES_EACH = 4
# In the long round everybody asks, the plain member in all places, others in so many of theirs; in the longest, in all.
_LONG_PLACES_EACH = 4


@pytest.fixture(scope="module")
def world(start_api: StartApi) -> World:
    return worlds.build(start_api(), places_each=_PLACES_EACH)


@pytest.fixture(scope="module")
def whole_world(start_api: StartApi) -> World:
    return worlds.build(start_api())


def _wrong(world: World, operation: str, caller: Caller, by: Principal) -> str | None:
    """Make one request, and return what is wrong with its answer."""
    requested = caller.request(by)
    answer = world.api.as_(None).call(requested.method, requested.path, requested.body, requested.query, by.headers)
    verdict, expected = caller.verdict(answer), _expected(operation, caller, by, requested)
    if answer.status < 300 and caller.undo is not None:
        caller.undo(by)
    if verdict is not expected:
        return f"{by.named}: {verdict}, not {expected.value} ({answer.body})"
    if caller.shows is not None and verdict is Verdict.done:
        is_seen = level(by.carrier, by.place, caller.about) >= _needed(operation, caller)
        if caller.shows(answer.body, by) != is_seen:
            return f"{by.named}: is {'not shown it' if is_seen else 'shown it'}"
    return None


def _expected(operation: str, caller: Caller, by: Principal, requested: Request) -> Verdict:
    for item in filter(None, (caller.via, operation)):
        verdict = _expected_of(item, caller, by, requested)
        if verdict is not Verdict.done:
            return verdict
    return Verdict.done


def _expected_of(operation: str, caller: Caller, by: Principal, requested: Request) -> Verdict:
    without_rights = admitted(OPERATIONS[operation], by.carrier, is_change=requested.method != "GET")
    if without_rights is not Verdict.done:
        return without_rights
    if (caller.is_boundless and by.carrier.is_limited) or not caller.scopes & by.carrier.scopes:
        return Verdict.refused
    if caller.about is About.server or caller.shows is not None:
        return Verdict.done
    locked = level(by.carrier, by.place, caller.about)
    if locked >= _needed(operation, caller):
        return Verdict.done
    if caller.about is About.owner:
        return Verdict.refused
    return Verdict.unseen if locked == 0 or caller.hides else Verdict.refused


def _needed(operation: str, caller: Caller) -> int:
    return caller.needs or needed(OPERATIONS[operation])


def _some(world: World, operation: str) -> Sequence[Principal]:
    """Return some of all who ask; which ones differs between operations."""
    rng = random.Random(operation)
    members = [by for by in world.principals if by.carrier is MEMBER]
    unplaced = [by for by in world.principals if by.carrier in UNPLACED]
    others = [[by for by in world.principals if by.carrier is carrier] for carrier in PLACED if carrier is not MEMBER]
    chosen = [rng.choice(item) for item in rng.sample(others, _PLACED)]
    return [*rng.sample(members, _MEMBERS), *chosen, *rng.sample(unplaced, _UNPLACED)]


@pytest.mark.parametrize("operation", sorted(CALLERS))
def test_operation(world: World, operation: str) -> None:
    """Each operation answers some of all who ask as the rule says."""
    actual = [_wrong(world, operation, caller, by) for caller in CALLERS[operation] for by in _some(world, operation)]
    assert [item for item in actual if item] == []


def _many(world: World, operation: str) -> Sequence[Principal]:
    """Return all kinds of those who ask; the places from which they do differ between operations."""
    rng = random.Random(operation)
    chosen = []
    for carrier in (*PLACED, *UNPLACED):
        others = [by for by in world.principals if by.carrier is carrier]
        chosen += others if carrier is MEMBER else rng.sample(others, min(len(others), _LONG_PLACES_EACH))
    return chosen


@pytest.mark.timeout(900)
@pytest.mark.parametrize("operation", sorted(CALLERS))
@pytest.mark.parametrize(
    "chosen",
    [
        pytest.param(_many, id="everybody", marks=pytest.mark.slow),
        pytest.param(lambda world, _: world.principals, id="everybody-everywhere", marks=pytest.mark.soak),
    ],
)
def test_operation_in_full(
    whole_world: World, operation: str, chosen: Callable[[World, str], Sequence[Principal]]
) -> None:
    """Each operation answers everybody as the rule says, wherever they are."""
    principals = chosen(whole_world, operation)
    actual = [_wrong(whole_world, operation, caller, by) for caller in CALLERS[operation] for by in principals]
    assert [item for item in actual if item] == []


def test_every_operation_is_called() -> None:
    """Every operation has a caller, so that the matrix covers it.

    The app itself checks that every route has a row in the table of operations.
    """
    called = CALLERS.keys() | PUBLIC_OPERATIONS
    how = "add to tests/integration/access/callers_of_objects.py, or callers_of_people.py, how to call:"
    assert sorted(OPERATIONS.keys() - called) == [], how
    assert sorted(called - OPERATIONS.keys()) == [], "these are no operations any more; drop their callers:"
    assert sorted(CALLERS.keys() & PUBLIC_OPERATIONS) == []
    ports = {name for name, need in OPERATIONS.items() if need.guests and need.on is ResourceKind.none}
    assert ports == PUBLIC_OPERATIONS, "operations for guests without an object are exactly the public endpoints"
