"""Make a damaged file from a number: the same file each time."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from tests.fuzz.seeds import Seed

_MOST_DAMAGES = 6
_WORDS = (b"\xff" * 8, bytes(8), (2**63).to_bytes(8, "little"), b"\xff" * 4, b"\x7f" + b"\xff" * 3, b"\x00\x00\x00\x80")


def mutated(case: int, seeds: Sequence[Seed]) -> Seed:
    """Return the damaged file of a case."""
    chance = random.Random(case)  # the same case each time, not a secret
    seed = chance.choice(seeds)
    data = bytearray(seed.data)
    for _ in range(chance.randint(1, _MOST_DAMAGES)):
        chance.choice(_DAMAGES)(chance, data, seeds)
        data = data or bytearray(b"x")
    return Seed(seed.name, bytes(data))


def _place(chance: random.Random, data: bytearray) -> int:
    """Return a place; the end of a file, where the index is, more often than its share."""
    if chance.random() < 0.4:
        return max(0, len(data) - 1 - chance.randrange(600))
    return chance.randrange(len(data))


def _flip(chance: random.Random, data: bytearray, _seeds: Sequence[Seed]) -> None:
    data[_place(chance, data)] ^= 1 << chance.randrange(8)


def _word(chance: random.Random, data: bytearray, _seeds: Sequence[Seed]) -> None:
    at = _place(chance, data)
    word = chance.choice([*_WORDS, len(data).to_bytes(8, "little"), chance.randrange(2**16).to_bytes(4, "little")])
    data[at : at + len(word)] = word


def _rubbish(chance: random.Random, data: bytearray, _seeds: Sequence[Seed]) -> None:
    at = _place(chance, data)
    data[at : at + chance.randrange(30)] = chance.randbytes(chance.randrange(30))


def _zeros(chance: random.Random, data: bytearray, _seeds: Sequence[Seed]) -> None:
    at = _place(chance, data)
    data[at : at + 512] = bytes(min(512, len(data) - at))


def _repeat(chance: random.Random, data: bytearray, _seeds: Sequence[Seed]) -> None:
    start = chance.randrange(len(data))
    at = _place(chance, data)
    data[at:at] = data[start : start + chance.randint(1, 300)]


def _cut(chance: random.Random, data: bytearray, _seeds: Sequence[Seed]) -> None:
    del data[_place(chance, data) + 1 :]


def _remove(chance: random.Random, data: bytearray, _seeds: Sequence[Seed]) -> None:
    at = _place(chance, data)
    del data[at : at + chance.randint(1, 200)]


def _cross(chance: random.Random, data: bytearray, seeds: Sequence[Seed]) -> None:
    other = chance.choice(seeds).data
    start = chance.randrange(len(other))
    at = _place(chance, data)
    data[at : at + 100] = other[start : start + chance.randint(1, 400)]


_DAMAGES: tuple[Callable[[random.Random, bytearray, Sequence[Seed]], None], ...] = (
    _flip,
    _flip,
    _word,
    _word,
    _rubbish,
    _zeros,
    _repeat,
    _cut,
    _remove,
    _cross,
)
