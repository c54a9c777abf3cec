"""Passwords: hashed with argon2id, outside of any transaction, a few at a time.

A guess at an account that is not there takes as long as at one that is.
"""

import asyncio
import re
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
# Of zxcvbn's five: below, a hundred million guesses find it.
_LEAST_SCORE = 3
# It refuses to look at more, and takes longer than linearly.
_LOOKED_AT = 72
_OWN_NAMES = ("kleinkram", "klein")
_LEAST_WORD = 3
_LEAST_OF_ITS_OWN = 6


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

    async def hash_new(self, password: str, *, field: str, about: tuple[str | None, ...]) -> str:
        """Return what is kept of a password that somebody chooses; `about` are names and addresses of theirs.

        Raises:
            InvalidRequest: it is known, or easy to guess.
            SlowDown: too many wait already.
        """
        refuse_obvious(password, field=field, about=about)
        await self._in_turn(lambda: _refuse_known(password, field=field, about=about))
        return await self.hash(password)

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
    """See that a password is not little more than somebody's name or address, or the name of this software.

    Raises:
        InvalidRequest: it is.
    """
    folded = "".join(letter for letter in password.casefold() if letter.isalnum())
    rest = folded
    for word in sorted(_words_of((*about, *_OWN_NAMES)), key=len, reverse=True):
        rest = rest.replace(word, "")
    if rest != folded and len(rest) < _LEAST_OF_ITS_OWN:
        message = "is little more than your name or address, or the name of this server; choose another"
        raise InvalidRequest(problems=[FieldProblem(field=field, message=message)])


def _words_of(texts: tuple[str | None, ...]) -> set[str]:
    """Return the words of names and addresses, without those that are too short to mean anything."""
    words = {word for text in texts if text for word in re.findall(r"[^\W_]+", text.casefold())}
    whole = {"".join(re.findall(r"[^\W_]+", text.casefold())) for text in texts if text}
    return {word for word in words | whole if len(word) >= _LEAST_WORD}


def _refuse_known(password: str, *, field: str, about: tuple[str | None, ...]) -> None:
    from zxcvbn import zxcvbn  # loads its lists of known passwords, which only a process that needs them shall hold

    found = zxcvbn(password[:_LOOKED_AT], user_inputs=sorted(_words_of((*about, *_OWN_NAMES))))
    if found["score"] >= _LEAST_SCORE:
        return
    why = str(found["feedback"]["warning"]).rstrip(".") or "It is easy to guess"
    message = f"is not safe: {why[0].lower()}{why[1:]}. Choose another, such as four words that do not belong together"
    raise InvalidRequest(problems=[FieldProblem(field=field, message=message)])
