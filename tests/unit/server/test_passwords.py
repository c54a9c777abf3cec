"""Password hashing: constant effort for unknown accounts, limited concurrency, weak passwords refused."""

import asyncio
import time

import pytest

from kleinkram.contract.errors import InvalidRequest, SlowDown
from kleinkram.server.auth import local_accounts
from kleinkram.server.auth.local_accounts import PasswordHasher, refuse_obvious_password

_PASSWORD = "correct horse battery"


async def test_a_hash_verifies_only_its_own_password() -> None:
    hasher = PasswordHasher()
    hashed = await hasher.hash(_PASSWORD)
    assert hashed.startswith("$argon2id$")
    assert await hasher.hash(_PASSWORD) != hashed
    assert await hasher.verify(hashed, _PASSWORD)
    assert not await hasher.verify(hashed, _PASSWORD + " ")
    assert not await hasher.verify("$argon2id$not a hash", _PASSWORD)
    assert not hasher.is_outdated(hashed)


async def test_verifying_without_an_account_takes_as_much_work_as_with_one() -> None:
    hasher = PasswordHasher()
    hashed = await hasher.hash(_PASSWORD)
    await hasher.verify(None, _PASSWORD)  # the first creates the hash that it compares with

    async def work_s(password_hash: str | None) -> float:
        started = time.process_time()
        for _ in range(3):
            assert not await hasher.verify(password_hash, "a wrong one")
        return time.process_time() - started

    with_account, without_account = await work_s(hashed), await work_s(None)
    assert 0.5 < without_account / with_account < 2


async def test_too_many_waiting_requests_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_accounts, "_MAX_WAITING", 3)
    hasher = PasswordHasher()
    results = await asyncio.gather(*(hasher.hash(_PASSWORD) for _ in range(5)), return_exceptions=True)
    assert [type(result) for result in results] == [str, str, str, SlowDown, SlowDown]
    assert await hasher.hash(_PASSWORD)


@pytest.mark.parametrize("obvious", ["Ada Lovelace", "ada lovelace", "ada@lab.example", "ADA "])
def test_names_and_addresses_are_refused_as_passwords(obvious: str) -> None:
    with pytest.raises(InvalidRequest, match="name or address"):
        refuse_obvious_password(obvious, field="password", about=("Ada Lovelace", "ada@lab.example", None))
    refuse_obvious_password(_PASSWORD, field="password", about=("Ada Lovelace", "ada@lab.example", None))


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
async def test_common_and_trivial_passwords_are_refused_with_a_reason(known: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        await PasswordHasher().hash_new(known, field="password", about=("Ada Lovelace", "ada@lab.example"))
    (problem,) = refused.value.problems
    assert problem.field == "password"
    assert "choose another" in problem.message.casefold()


@pytest.mark.parametrize("good", [_PASSWORD, "xK9#mQ2$vLw", "glacier teapot violin"])
async def test_good_passwords_are_accepted(good: str) -> None:
    assert (await PasswordHasher().hash_new(good, field="password", about=("Ada Lovelace", None))).startswith(
        "$argon2id$"
    )
