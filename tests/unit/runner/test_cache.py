"""The input cache: keeps inputs in use, evicts the least recently used, and verifies bytes."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import threading
import time
from pathlib import Path

import pytest

from kleinkram.client.errors import InvalidInput
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


def wait(seconds: float) -> None:
    """Wait without a stop request."""
    time.sleep(seconds)


def bring(cache: InputCache, data: bytes, used: float) -> None:
    """Add a file to the cache, last used at some time."""
    cache.make_space([input_file(data)])
    cache.get(input_file(data), giving(data), wait)
    os.utime(cache.directory / f"{input_file(data).sha256}.seal", (used, used))


def stored(cache: InputCache, *files: bytes) -> list[bool]:
    return [(cache.directory / f"{input_file(data).sha256}.file").exists() for data in files]


def names(cache: InputCache) -> set[str]:
    return {path.suffix for path in cache.directory.iterdir()}


def test_cached_inputs_are_not_downloaded_again(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"
    cache.get(input_file(data), giving(data), wait)
    cache.get(input_file(data), never, wait)
    assert InputCache(tmp_path / "cache", 1000).place(input_file(data), [tmp_path / "drive.bag"])
    assert (tmp_path / "drive.bag").read_bytes() == data
    assert (tmp_path / "drive.bag").stat().st_mode & 0o777 == 0o444
    assert names(cache) == {"", ".file", ".seal"}


def test_least_recently_used_files_are_evicted_first(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 30)
    old, used, newer, new = b"1" * 10, b"2" * 10, b"3" * 10, b"4" * 10
    bring(cache, used, 1)
    cache.place(input_file(used), [tmp_path / "in-a-run"])
    bring(cache, old, 2)
    bring(cache, newer, 3)
    bring(cache, new, 4)
    assert stored(cache, old, used, newer, new) == [False, True, True, True]
    cache.place(input_file(newer), [tmp_path / "in-another"])
    bring(cache, b"5" * 20, 5)
    assert stored(cache, used, newer, new) == [True, True, False]
    (tmp_path / "in-a-run").unlink()
    (tmp_path / "in-another").unlink()
    bring(cache, b"6" * 30, 6)
    assert stored(cache, used, newer, b"6" * 30) == [False, False, True]


def test_unused_files_are_evicted_by_age(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    old, used, new = b"1" * 10, b"2" * 10, b"3" * 10
    now = time.time()
    for data in (old, used, new):
        bring(cache, data, now - 3000 if data != new else now)
    cache.place(input_file(used), [tmp_path / "in-a-run"])
    os.utime(cache.directory / f"{input_file(used).sha256}.seal", (1, 1))
    InputCache(tmp_path / "cache", 1000, max_age_s=3600)
    assert stored(cache, old, used, new) == [True, True, True]
    InputCache(tmp_path / "cache", 1000, max_age_s=1800)
    assert stored(cache, old, used, new) == [False, True, True]


def test_damaged_bytes_are_downloaded_once_more(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    data, wrong = b"bytes of a drive", b"Bytes of a drive"
    values = iter([wrong, data])
    cache.get(input_file(data), lambda part: part.add(next(values)), wait)
    cache.get(input_file(data), never, wait)
    other = input_file(b"x")
    with pytest.raises(InputDamaged):
        cache.get(other, giving(b"y"), wait)
    assert not cache.place(other, [tmp_path / "other"])
    assert not list(cache.directory.glob("*.part"))


def test_a_changed_file_is_downloaded_again(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"
    cache.get(input_file(data), giving(data), wait)
    (path,) = cache.directory.glob("*.file")
    path.chmod(0o644)
    path.write_bytes(b"others of a cat.")
    assert not cache.place(input_file(data), [tmp_path / "drive.bag"])
    cache.get(input_file(data), giving(data), wait)
    assert path.read_bytes() == data


def interrupt(cache: InputCache, data: bytes) -> None:
    """Download five bytes, then fail."""

    def broken(part: PartialInput) -> None:
        part.add(data[:5])
        raise ConnectionError

    with pytest.raises(ConnectionError):
        cache.get(input_file(data), broken, wait)


def test_interrupted_downloads_are_continued(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    data = b"bytes of a drive"
    interrupt(cache, data)
    rest: list[int] = []

    def going_on(part: PartialInput) -> None:
        rest.append(part.offset)
        part.add(data[part.offset :])

    InputCache(tmp_path / "cache", 1000).get(input_file(data), going_on, wait)
    assert rest == [5]


def test_abandoned_downloads_are_removed_for_space_or_after_a_day_but_not_running_ones(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 20)
    interrupt(cache, b"bytes of a drive")
    cache.make_space([input_file(b"1" * 15)])
    assert len([*cache.directory.glob("*.part")]) == 1
    cache.make_space([input_file(b"1" * 16)])
    assert not [*cache.directory.glob("*.part")]

    interrupt(cache, b"bytes of a drive")
    (part,) = cache.directory.glob("*.part")
    day_ago = time.time() - 86_500
    os.utime(part, (day_ago, day_ago))
    with part.open("r+b") as running:
        fcntl.flock(running, fcntl.LOCK_EX)
        InputCache(tmp_path / "cache", 1)
        assert part.exists()
    InputCache(tmp_path / "cache", 1000)
    assert not part.exists()


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


def test_a_file_that_is_evicted_while_others_are_downloaded_is_downloaded_again(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    first, second = input_file(b"first"), input_file(b"second")
    fetched: list[InputFile] = []

    class Source:
        def fetch_into(self, cache: InputCache, missing: object, place: cache_module.Place) -> None:
            waiting = [first, second]
            while waiting:
                fetched.append(file := waiting.pop(0))
                data = b"first" if file == first else b"second"
                cache.get(file, giving(data), wait)
                if len(fetched) == 1:
                    for path in cache.directory.glob("*.file"):
                        path.unlink()
                if not place(file):
                    waiting.append(file)

    files = {"a/first.bag": first, "second.bag": second, "b/first.bag": first}
    cache_module.place_inputs(cache, tmp_path / "in", files, Source(), copy=False)
    assert fetched == [first, second, first]
    assert {path: (tmp_path / "in" / path).read_bytes() for path in files} == {
        "a/first.bag": b"first",
        "second.bag": b"second",
        "b/first.bag": b"first",
    }


def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    with pytest.raises(NoSpace, match="are free"):
        cache.make_space([InputFile("0" * 64, 2**60)])


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_at_a_quota_unused_files_make_room_and_then_it_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    cache = InputCache(tmp_path / "cache", 1000)
    quota_bytes = 20

    def pwrite(descriptor: int, data: bytes, offset: int) -> int:
        if sum(path.stat().st_size for path in cache.directory.iterdir() if ".seal" not in path.name) >= quota_bytes:
            raise OSError(number, os.strerror(number))
        os.lseek(descriptor, offset, os.SEEK_SET)
        return os.write(descriptor, data[:5])

    monkeypatch.setattr(os, "pwrite", pwrite)
    for data in (b"1" * 10, b"2" * 10):
        bring(cache, data, int(data[:1]))
    cache.place(input_file(b"2" * 10), [tmp_path / "in-a-run"])
    bring(cache, b"3" * 10, 3)
    assert stored(cache, b"1" * 10, b"2" * 10, b"3" * 10) == [False, True, True]
    cache.place(input_file(b"3" * 10), [tmp_path / "in-another"])
    with pytest.raises(NoSpace, match=f"{cache.directory} .*takes no more: {os.strerror(number)}"):
        bring(cache, b"4" * 10, 4)


def test_a_file_system_without_locks_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(*_: object) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(InvalidInput, match="no file locks"):
        InputCache(tmp_path / "cache", 1000)
