"""The cache keeps what runs use, lets go of what was not used for longest, and believes no other bytes."""

from __future__ import annotations

import hashlib
import os
import threading
from pathlib import Path

import pytest

from kleinkram.runner import cache as cache_module
from kleinkram.runner.cache import Cache, Damaged, NoRoom, Part, Wanted


def wanted(data: bytes) -> Wanted:
    return Wanted(hashlib.sha256(data).hexdigest(), len(data))


def giving(data: bytes, calls: list[bytes] | None = None) -> cache_module.Fetch:
    def fetch(part: Part) -> None:
        if calls is not None:
            calls.append(data)
        part.add(data[part.offset :])

    return fetch


def never(_: Part) -> None:
    pytest.fail("it was fetched, and is here")


def wait(_: float) -> None:
    """Wait as a run does that nobody ends."""


def bring(cache: Cache, data: bytes, used: float) -> None:
    """Have a file in the cache, last used at some time."""
    cache.make_room([wanted(data)])
    cache.get(wanted(data), giving(data), wait)
    os.utime(cache._folder / f"{wanted(data).sha256}.seal", (used, used))


def kept(cache: Cache, *files: bytes) -> list[bool]:
    return [(cache._folder / f"{wanted(data).sha256}.file").exists() for data in files]


def test_what_is_here_is_not_fetched_again(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"
    cache.get(wanted(data), giving(data), wait)
    cache.get(wanted(data), never, wait)
    assert Cache(tmp_path / "cache", 1000).missing([wanted(data)]) == []
    cache.link(wanted(data), tmp_path / "drive.bag")
    assert (tmp_path / "drive.bag").read_bytes() == data
    assert (tmp_path / "drive.bag").stat().st_mode & 0o777 == 0o444


def test_the_longest_unused_goes_first_and_what_is_used_stays(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache", 30)
    old, used, newer, new = b"1" * 10, b"2" * 10, b"3" * 10, b"4" * 10
    bring(cache, used, 1)
    cache.link(wanted(used), tmp_path / "in-a-run")
    bring(cache, old, 2)
    bring(cache, newer, 3)
    bring(cache, new, 4)
    assert kept(cache, old, used, newer, new) == [False, True, True, True]
    with cache.pinned([wanted(newer)]):
        bring(cache, b"5" * 20, 5)
    assert kept(cache, used, newer, new) == [True, True, False]
    (tmp_path / "in-a-run").unlink()
    bring(cache, b"6" * 30, 6)
    assert kept(cache, used, newer, b"6" * 30) == [False, False, True]


def test_other_bytes_are_fetched_once_more(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache", 1000)
    data, wrong = b"bytes of a drive", b"Bytes of a drive"
    said = iter([wrong, data])
    cache.get(wanted(data), lambda part: part.add(next(said)), wait)
    cache.get(wanted(data), never, wait)
    other = wanted(b"x")
    with pytest.raises(Damaged):
        cache.get(other, giving(b"y"), wait)
    assert cache.missing([other]) == [other]


def test_what_an_interrupted_fetch_left_counts(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"

    def broken(part: Part) -> None:
        part.add(data[:5])
        raise ConnectionError

    with pytest.raises(ConnectionError):
        cache.get(wanted(data), broken, wait)
    rest: list[int] = []

    def going_on(part: Part) -> None:
        rest.append(part.offset)
        part.add(data[part.offset :])

    cache.get(wanted(data), going_on, wait)
    assert rest == [5]


def test_many_that_want_one_file_fetch_it_once(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"
    calls: list[bytes] = []
    all_are_there = threading.Barrier(4)

    def get() -> None:
        all_are_there.wait()
        cache.get(wanted(data), giving(data, calls), wait)

    threads = [threading.Thread(target=get) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert calls == [data]


def test_a_disk_without_room_is_told(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache", 1000)
    with pytest.raises(NoRoom, match="are free"):
        cache.make_room([Wanted("0" * 64, 2**60)])
