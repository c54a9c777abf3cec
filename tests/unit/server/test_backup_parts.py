"""Sealed files: what was changed, cut off, moved or renamed is noticed. Names: what is there is found."""

import asyncio
import random
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from kleinkram.server.backup.failing import CannotWrite, Damaged, NotOpened
from kleinkram.server.backup.names import Names
from kleinkram.server.backup.sealing import Seal, new_key, open_key, sealed_size
from kleinkram.server.backup.shelf import FolderShelf

_MIB = 1024 * 1024
_SEAL = Seal(bytes(32))
_HEAD, _FRAME = sealed_size(0) - 16, _MIB + 16


async def _pieces(body: bytes, size: int) -> AsyncIterator[bytes]:
    for start in range(0, len(body), size):
        yield body[start : start + size]


def _sealed(body: bytes, about: str = "name", size: int = 300_000) -> bytes:
    async def go() -> bytes:
        return b"".join([entry async for entry in _SEAL.seal(_pieces(body, size), about)])

    return asyncio.run(go())


def _opened(sealed: bytes, about: str = "name", size: int = 333_333) -> bytes:
    async def go() -> bytes:
        return b"".join([entry async for entry in _SEAL.unseal(_pieces(sealed, size), about)])

    return asyncio.run(go())


@pytest.mark.parametrize("length", [0, 1, _MIB - 1, _MIB, _MIB + 1, 2 * _MIB, 2 * _MIB + 12345])
def test_what_was_sealed_is_opened(length: int) -> None:
    body = random.Random(length).randbytes(length)
    sealed = _sealed(body)
    assert len(sealed) == sealed_size(length)
    assert _opened(sealed) == body
    assert _sealed(body) != sealed, "the same content never looks the same"
    with pytest.raises(Damaged):
        _opened(sealed, "another name")


def test_damage_is_noticed() -> None:
    body = random.Random(1).randbytes(2 * _MIB + 5)
    sealed = _sealed(body)
    first, second = sealed[_HEAD : _HEAD + _FRAME], sealed[_HEAD + _FRAME : _HEAD + 2 * _FRAME]
    wrong = {
        "a bit": sealed[:-3] + bytes([sealed[-3] ^ 1]) + sealed[-2:],
        "the last byte": sealed[:-1],
        "the last frame": sealed[: _HEAD + 2 * _FRAME],
        "all frames": sealed[:_HEAD],
        "half the head": sealed[:10],
        "everything": b"",
        "two frames swapped": sealed[:_HEAD] + second + first + sealed[_HEAD + 2 * _FRAME :],
        "a frame twice": sealed[: _HEAD + _FRAME] + first + sealed[_HEAD + _FRAME :],
        "another's salt": _sealed(body)[:_HEAD] + sealed[_HEAD:],
        "something after it": sealed + b"x",
    }
    for what, bad in wrong.items():
        with pytest.raises(Damaged):
            pytest.fail(f"{what}: {len(_opened(bad))} bytes came")


def test_only_its_passphrase_opens_a_key() -> None:
    seal, stored = new_key("horse")
    assert open_key(stored, "horse").name(bytes(32)) == seal.name(bytes(32))
    with pytest.raises(NotOpened):
        open_key(stored, "Horse")


def test_names_are_found_with_their_sizes_and_marks() -> None:
    chance = random.Random(3)
    every = sorted(chance.randbytes(32) for _ in range(1000))
    names = Names()
    for number, name in enumerate(every[::2]):
        names.append(name, number)
    assert [names.size_bytes(name) for name in every[::2]] == [*range(500)]
    assert {names.size_bytes(name) for name in every[1::2]} == {None}
    for name in every[::4]:
        place = names.place(name)
        assert place is not None
        names.mark(place)
    assert {name for name, _ in names.unmarked()} == {*every[2::4]}


def test_a_write_that_fails_leaves_nothing(tmp_path: Path) -> None:
    shelf = FolderShelf(tmp_path)

    async def broken() -> AsyncIterator[bytes]:
        yield b"half"
        raise CannotWrite("it ended")

    async def go() -> list[str]:
        with pytest.raises(CannotWrite):
            await shelf.put("data/ab/abc", broken(), 8)
        await shelf.put("data/ab/abd", _pieces(b"whole", 2), 5)
        return [item.path async for item in shelf.listed("")]

    assert asyncio.run(go()) == ["data/ab/abd"]
