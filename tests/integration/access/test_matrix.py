"""The matrix: every operation with every credential at every level on the project and on the mission."""

import random
from collections.abc import Sequence

import pytest

from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from tests.integration.access import world as worlds
from tests.integration.access.call import Caller, Request
from tests.integration.access.callers import CALLERS, PUBLIC_OPERATIONS
from tests.integration.access.credentials import MEMBER, WITH_GRANTS, WITHOUT_GRANTS
from tests.integration.access.expectations import Target, Verdict, credential_verdict, level, required_level
from tests.integration.access.world import Principal, World
from tests.integration.conftest import StartApi

# Principals per operation in the short round: members, other credentials with grants, credentials without grants.
_MEMBERS, _OTHERS, _UNGRANTED = 4, 7, 3
# Some operations need a sign-in that is not old; on a busy machine, all operations take longer than that lasts.
_FRESH_SIGN_IN_S = 86_400
# Access levels per credential in the short and the long round. The member has all of them in every round.
_LEVELS_PER_CREDENTIAL = 4


@pytest.fixture(scope="module")
def world(start_api: StartApi) -> World:
    return worlds.build(start_api(fresh_sign_in_s=_FRESH_SIGN_IN_S), levels_per_credential=_LEVELS_PER_CREDENTIAL)


@pytest.fixture(scope="module")
def whole_world(start_api: StartApi) -> World:
    return worlds.build(start_api(fresh_sign_in_s=_FRESH_SIGN_IN_S))


def _mismatch(world: World, operation: str, caller: Caller, principal: Principal) -> str | None:
    """Make one request, and return how its response differs from the expected one."""
    requested = caller.request(principal)
    answer = world.api.as_(None).call(
        requested.method, requested.path, requested.body, requested.query, principal.headers
    )
    verdict, expected = caller.verdict(answer), _expected(operation, caller, principal, requested)
    if answer.status < 300 and caller.undo is not None:
        caller.undo(principal)
    if verdict is not expected:
        return f"{principal.named}: {verdict}, not {expected.value} ({answer.body})"
    if caller.shows is not None and verdict is Verdict.ok:
        is_visible = level(principal.credential, principal.levels, caller.target) >= _required_level(operation, caller)
        if caller.shows(answer.body, principal) != is_visible:
            return f"{principal.named}: the object is {'missing in' if is_visible else 'visible in'} the response"
    return None


def _expected(operation: str, caller: Caller, principal: Principal, requested: Request) -> Verdict:
    for item in filter(None, (caller.via, operation)):
        verdict = _expected_of(item, caller, principal, requested)
        if verdict is not Verdict.ok:
            return verdict
    return Verdict.ok


def _expected_of(operation: str, caller: Caller, principal: Principal, requested: Request) -> Verdict:
    without_rights = credential_verdict(
        OPERATIONS[operation], principal.credential, is_change=requested.method != "GET"
    )
    if without_rights is not Verdict.ok:
        return without_rights
    if (
        caller.needs_unlimited_credential and principal.credential.is_limited
    ) or not caller.scopes & principal.credential.scopes:
        return Verdict.forbidden
    if caller.target is Target.server or caller.shows is not None:
        return Verdict.ok
    actual_level = level(principal.credential, principal.levels, caller.target)
    if actual_level >= _required_level(operation, caller):
        return Verdict.ok
    if caller.target is Target.owner:
        return Verdict.forbidden
    return Verdict.not_found if actual_level == 0 or caller.hides else Verdict.forbidden


def _required_level(operation: str, caller: Caller) -> int:
    return caller.required_level or required_level(OPERATIONS[operation])


def _sample(world: World, operation: str) -> Sequence[Principal]:
    """Return a sample of the principals, which differs between operations."""
    rng = random.Random(operation)
    members = [principal for principal in world.principals if principal.credential is MEMBER]
    ungranted = [principal for principal in world.principals if principal.credential in WITHOUT_GRANTS]
    others = [
        [principal for principal in world.principals if principal.credential is credential]
        for credential in WITH_GRANTS
        if credential is not MEMBER
    ]
    chosen = [rng.choice(item) for item in rng.sample(others, _OTHERS)]
    return [*rng.sample(members, _MEMBERS), *chosen, *rng.sample(ungranted, _UNGRANTED)]


@pytest.mark.parametrize("operation", sorted(CALLERS))
def test_operation_permits_what_the_model_permits(world: World, operation: str) -> None:
    """A sample of principals per operation."""
    actual = [
        _mismatch(world, operation, caller, principal)
        for caller in CALLERS[operation]
        for principal in _sample(world, operation)
    ]
    assert [item for item in actual if item] == []


def _rest(world: World, operation: str, target: Target) -> Sequence[Principal]:
    """Return what the sample leaves out: the other credentials with one access level, and the member with the others.

    Where the target is no part of a project, the levels of the member in the sample are enough.
    """
    rng = random.Random(operation)
    sample = _sample(world, operation)
    sampled = {principal.credential for principal in sample}
    others = [
        [principal for principal in world.principals if principal.credential is credential]
        for credential in (*WITH_GRANTS, *WITHOUT_GRANTS)
        if credential not in sampled
    ]
    members = [principal for principal in world.principals if principal.credential is MEMBER]
    depends_on_levels = target in {Target.project, Target.mission, Target.file}
    rest = [member for member in members if member not in sample] if depends_on_levels else []
    return [*map(rng.choice, others), *rest]


@pytest.mark.slow
@pytest.mark.parametrize("operation", sorted(CALLERS))
def test_operation_permits_the_other_credentials_what_the_model_permits(world: World, operation: str) -> None:
    """All credentials, and the member with all access levels, together with the sample."""
    actual = [
        _mismatch(world, operation, caller, principal)
        for caller in CALLERS[operation]
        for principal in _rest(world, operation, caller.target)
    ]
    assert [item for item in actual if item] == []


@pytest.mark.soak
@pytest.mark.parametrize("operation", sorted(CALLERS))
def test_operation_permits_every_principal_what_the_model_permits(whole_world: World, operation: str) -> None:
    """Each credential with each access level."""
    actual = [
        _mismatch(whole_world, operation, caller, principal)
        for caller in CALLERS[operation]
        for principal in whole_world.principals
    ]
    assert [item for item in actual if item] == []


def test_every_operation_is_called() -> None:
    """Every operation has a caller, so that the matrix covers it.

    The app itself checks that every route has a row in the table of operations.
    """
    called = CALLERS.keys() | PUBLIC_OPERATIONS
    hint = "add callers to tests/integration/access/callers_of_objects.py or callers_of_people.py for:"
    assert sorted(OPERATIONS.keys() - called) == [], hint
    assert sorted(called - OPERATIONS.keys()) == [], "remove the callers of these former operations:"
    assert sorted(CALLERS.keys() & PUBLIC_OPERATIONS) == []
    guest_operations = {name for name, need in OPERATIONS.items() if need.guests and need.on is ResourceKind.none}
    assert guest_operations == PUBLIC_OPERATIONS, (
        "operations for guests without an object are exactly the public endpoints"
    )
