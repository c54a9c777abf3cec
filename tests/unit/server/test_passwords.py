"""Hashing of passwords: as slow for nobody's account as for somebody's, never more at once than a machine bears."""

import asyncio
import time

import pytest

from kleinkram.contract.errors import InvalidRequest, SlowDown
from kleinkram.server.auth import passwords
from kleinkram.server.auth.passwords import Passwords, refuse_obvious

_GIVEN = "correct horse battery"


async def test_a_password_is_the_one_that_was_hashed_and_no_other() -> None:
    hasher = Passwords()
    hashed = await hasher.hash(_GIVEN)
    assert hashed.startswith("$argon2id$")
    assert await hasher.hash(_GIVEN) != hashed
    assert await hasher.verify(hashed, _GIVEN)
    assert not await hasher.verify(hashed, _GIVEN + " ")
    assert not await hasher.verify("$argon2id$not a hash", _GIVEN)
    assert not hasher.is_outdated(hashed)


async def test_nobody_s_password_takes_as_much_work_as_somebody_s() -> None:
    hasher = Passwords()
    hashed = await hasher.hash(_GIVEN)
    await hasher.verify(None, _GIVEN)  # the first makes what it compares with

    async def work_s(kept: str | None) -> float:
        started = time.process_time()
        for _ in range(3):
            assert not await hasher.verify(kept, "a wrong one")
        return time.process_time() - started

    somebody_s, nobody_s = await work_s(hashed), await work_s(None)
    assert 0.5 < nobody_s / somebody_s < 2


async def test_who_comes_when_too_many_wait_is_told_to_come_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passwords, "_MOST_WAITING", 3)
    hasher = Passwords()
    results = await asyncio.gather(*(hasher.hash(_GIVEN) for _ in range(5)), return_exceptions=True)
    assert [type(result) for result in results] == [str, str, str, SlowDown, SlowDown]
    assert await hasher.hash(_GIVEN)


@pytest.mark.parametrize("obvious", ["Ada Lovelace", "ada lovelace", "ada@lab.example", "ADA "])
def test_one_s_name_and_address_are_no_passwords(obvious: str) -> None:
    with pytest.raises(InvalidRequest, match="name or address"):
        refuse_obvious(obvious, field="password", about=("Ada Lovelace", "ada@lab.example", None))
    refuse_obvious(_GIVEN, field="password", about=("Ada Lovelace", "ada@lab.example", None))


@pytest.mark.parametrize(
    "known",
    [
        "password12",
        "1234567890",
        "qwertyuiop",
        "kleinkram2026",
        "iloveyou2024",
        "p4ssw0rdp4ssw0rd",
        "a" * 200,
        "AdaLovelace-1815",
        "ada@lab.example!",
        "winterthur",
    ],
)
async def test_known_and_trivial_passwords_are_refused_with_a_sentence(known: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        await Passwords().hash_new(known, field="password", about=("Ada Lovelace", "ada@lab.example"))
    (problem,) = refused.value.problems
    assert problem.field == "password"
    assert "choose another" in problem.message.casefold()


@pytest.mark.parametrize("good", [_GIVEN, "xK9#mQ2$vLw", "glacier teapot violin"])
async def test_good_passwords_are_taken(good: str) -> None:
    assert (await Passwords().hash_new(good, field="password", about=("Ada Lovelace", None))).startswith("$argon2id$")
