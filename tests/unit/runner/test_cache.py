"""The input cache: keeps inputs in use, evicts the least recently used, and verifies bytes."""

from __future__ import annotations

import hashlib
import os
import threading
from pathlib import Path

import pytest

from kleinkram.runner import input_cache as cache_module
from kleinkram.runner.input_cache import InputCache, InputDamaged, InputFile, NoSpace, PartialInput


def input_file(data: bytes) -> InputFile:
    return InputFile(hashlib.sha256(data).hexdigest(), len(data))


def giving(data: bytes, calls: list[bytes] | None = None) -> cache_module.Fetch:
    def fetch(part: PartialInput) -> None:
        if calls is not None:
            calls.append(data)
        part.add(data[part.offset :])

    return fetch


def never(_: PartialInput) -> None:
    pytest.fail("it was fetched, and is here")


def wait(_: float) -> None:
    """Wait without a stop request."""


def bring(cache: InputCache, data: bytes, used: float) -> None:
    """Add a file to the cache, last used at some time."""
    cache.make_space([input_file(data)])
    cache.get(input_file(data), giving(data), wait)
    os.utime(cache._directory / f"{input_file(data).sha256}.seal", (used, used))


def stored(cache: InputCache, *files: bytes) -> list[bool]:
    return [(cache._directory / f"{input_file(data).sha256}.file").exists() for data in files]


def test_cached_inputs_are_not_downloaded_again(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"
    cache.get(input_file(data), giving(data), wait)
    cache.get(input_file(data), never, wait)
    assert InputCache(tmp_path / "cache", 1000).missing([input_file(data)]) == []
    cache.link(input_file(data), tmp_path / "drive.bag")
    assert (tmp_path / "drive.bag").read_bytes() == data
    assert (tmp_path / "drive.bag").stat().st_mode & 0o777 == 0o444


def test_least_recently_used_files_are_evicted_first(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 30)
    old, used, newer, new = b"1" * 10, b"2" * 10, b"3" * 10, b"4" * 10
    bring(cache, used, 1)
    cache.link(input_file(used), tmp_path / "in-a-run")
    bring(cache, old, 2)
    bring(cache, newer, 3)
    bring(cache, new, 4)
    assert stored(cache, old, used, newer, new) == [False, True, True, True]
    with cache.pinned([input_file(newer)]):
        bring(cache, b"5" * 20, 5)
    assert stored(cache, used, newer, new) == [True, True, False]
    (tmp_path / "in-a-run").unlink()
    bring(cache, b"6" * 30, 6)
    assert stored(cache, used, newer, b"6" * 30) == [False, False, True]


def test_damaged_bytes_are_downloaded_once_more(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    data, wrong = b"bytes of a drive", b"Bytes of a drive"
    values = iter([wrong, data])
    cache.get(input_file(data), lambda part: part.add(next(values)), wait)
    cache.get(input_file(data), never, wait)
    other = input_file(b"x")
    with pytest.raises(InputDamaged):
        cache.get(other, giving(b"y"), wait)
    assert cache.missing([other]) == [other]


def test_partial_downloads_count_towards_the_cache_size(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"

    def broken(part: PartialInput) -> None:
        part.add(data[:5])
        raise ConnectionError

    with pytest.raises(ConnectionError):
        cache.get(input_file(data), broken, wait)
    rest: list[int] = []

    def going_on(part: PartialInput) -> None:
        rest.append(part.offset)
        part.add(data[part.offset :])

    cache.get(input_file(data), going_on, wait)
    assert rest == [5]


def test_concurrent_requests_download_a_file_once(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"
    calls: list[bytes] = []
    all_are_there = threading.Barrier(4)

    def get() -> None:
        all_are_there.wait()
        cache.get(input_file(data), giving(data, calls), wait)

    threads = [threading.Thread(target=get) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert calls == [data]


def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    with pytest.raises(NoSpace, match="are free"):
        cache.make_space([InputFile("0" * 64, 2**60)])
