"""Passwords: hashed with argon2id, outside of any transaction, a few at a time.

A guess at an account that is not there takes as long as at one that is.
"""

import asyncio
import secrets
from collections.abc import Callable
from functools import cache
from typing import TypeVar

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from kleinkram.contract.accounts import MAX_PASSWORD_CHARACTERS
from kleinkram.contract.errors import FieldProblem, InvalidRequest, SlowDown

T = TypeVar("T")

# About 65 ms of a slow core, of the 150 ms that a sign-in may take: above OWASP's least (19 MiB, two passes).
_hasher = PasswordHasher(time_cost=2, memory_cost=32_768, parallelism=1, hash_len=32, salt_len=16)
# Each takes 32 MiB and a core: as many at a time, and as many that wait, before somebody is sent away.
_AT_ONCE = 2
_MOST_WAITING = 30
_PAUSE_S = 5.0


class Passwords:
    """Hashes and verifies, for one process."""

    def __init__(self) -> None:
        self._free = asyncio.Semaphore(_AT_ONCE)
        self._waiting = 0

    async def hash(self, password: str) -> str:
        """Return what is kept of a password.

        Raises:
            SlowDown: too many wait already.
        """
        return await self._in_turn(lambda: _hasher.hash(password))

    async def verify(self, hashed: str | None, password: str) -> bool:
        """Say whether a password is the one that was hashed; with None, take as long and say no.

        Raises:
            SlowDown: too many wait already.
        """
        return await self._in_turn(lambda: _is_same(hashed or _nobodys(), password)) and hashed is not None

    @staticmethod
    def is_outdated(hashed: str) -> bool:
        """Say whether a hash was made with other parameters than today's."""
        return _hasher.check_needs_rehash(hashed)

    async def _in_turn(self, work: Callable[[], T]) -> T:
        if self._waiting >= _MOST_WAITING:
            raise SlowDown(interval_s=_PAUSE_S)
        self._waiting += 1
        try:
            async with self._free:
                return await asyncio.to_thread(work)
        finally:
            self._waiting -= 1


def _is_same(hashed: str, password: str) -> bool:
    try:
        return _hasher.verify(hashed, password)
    except (VerificationError, InvalidHashError):
        return False


@cache
def _nobodys() -> str:
    return _hasher.hash(secrets.token_urlsafe(MAX_PASSWORD_CHARACTERS // 8))


def refuse_obvious(password: str, *, field: str, about: tuple[str | None, ...]) -> None:
    """See that a password is not just somebody's name or address.

    Raises:
        InvalidRequest: it is.
    """
    known = {word.casefold() for text in about if text for word in (text, text.partition("@")[0])}
    if password.casefold().strip() in known:
        problem = FieldProblem(field=field, message="is your name or address; choose another")
        raise InvalidRequest(problems=[problem])
