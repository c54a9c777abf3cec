"""`python -m ... SEED SECONDS FOLDER`: processes that use one cache, and are killed at random moments.

Each plays jobs: places some inputs, checks them, and removes them. Prints a JSON of what was seen; `problems` is empty
where no input was ever wrong, and no file was ever downloaded by two processes at once.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from kleinkram.runner.input_cache import InputCache, InputDamaged, InputFile, PartialInput, Place, place_inputs

_WORKERS = 4
_SLICE_BYTES = 5000
_random = random.Random(0)
_CONTENTS = [_random.randbytes(_random.randint(0, 60_000)) for _ in range(12)]
_FILES = {InputFile(hashlib.sha256(data).hexdigest(), len(data)): data for data in _CONTENTS}
_LIMIT_BYTES = sum(map(len, _CONTENTS)) * 3 // 4


class _Worker:
    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        self._random = random.Random(seed)
        self._job = folder / "jobs" / str(seed)

    def run(self) -> None:
        """Play jobs until killed."""
        while True:
            cache = InputCache(self._folder / "cache", _LIMIT_BYTES, max_age_s=3600)
            files = self._random.sample([*_FILES], self._random.randint(1, 4))
            with contextlib.suppress(ConnectionError):
                place_inputs(cache, self._job / "in", {file.sha256: file for file in files}, self, copy=False)
                for file in files:
                    if (self._job / "in" / file.sha256).read_bytes() != _FILES[file]:
                        self._report("problems", f"wrong bytes of {file.sha256}")
                self._report("placed", str(len(files)))
            shutil.rmtree(self._job)

    def fetch_into(self, cache: InputCache, missing: Sequence[InputFile], place: Place) -> None:
        """Download one after the other."""
        waiting = [*missing]
        while waiting:
            file = waiting.pop()
            with contextlib.suppress(InputDamaged):
                cache.get(file, self._fetch, time.sleep)
            if not place(file):
                waiting.append(file)

    def _fetch(self, part: PartialInput) -> None:
        data = _FILES[part.file]
        with self._downloads_alone(part.file):
            self._report("continued" if part.offset else "begun", part.file.sha256)
            while part.offset < part.file.size_bytes:
                piece = data[part.offset : part.offset + _SLICE_BYTES]
                if self._random.random() < 0.01:
                    piece = bytes(len(piece))
                part.add(piece)
                time.sleep(self._random.random() * 0.006)
                if self._random.random() < 0.01:
                    raise ConnectionError

    @contextlib.contextmanager
    def _downloads_alone(self, file: InputFile) -> Iterator[None]:
        with (self._folder / "alone" / file.sha256).open("w") as alone:
            try:
                fcntl.flock(alone, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self._report("problems", f"two downloads of {file.sha256}")
            yield

    def _report(self, kind: str, text: str) -> None:
        report = os.open(self._folder / kind, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.write(report, f"{text}\n".encode())
        os.close(report)


def _fork(folder: Path, seed: int) -> int:
    pid = os.fork()
    if pid == 0:
        try:
            _Worker(folder, seed).run()
        except BaseException as error:
            (folder / f"died-{seed}").write_text(repr(error))
        os._exit(1)
    return pid


def main(seed: int, seconds: float, folder: Path) -> None:
    """Run workers, kill them at random, and check what they left."""
    for name in ("jobs", "alone"):
        (folder / name).mkdir(parents=True)
    chance, until_s, kills = random.Random(seed), time.monotonic() + seconds, 0
    workers = [_fork(folder, number) for number in range(_WORKERS)]
    while time.monotonic() < until_s:
        time.sleep(chance.random() * 0.08)
        index = chance.randrange(_WORKERS)
        os.kill(workers[index], signal.SIGKILL)
        os.waitpid(workers[index], 0)
        kills += 1
        workers[index] = _fork(folder, _WORKERS + kills)
    for pid in workers:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    shutil.rmtree(folder / "jobs")
    counts = {name: _lines(folder / name) for name in ("placed", "begun", "continued")}
    sys.stdout.write(json.dumps({"kills": kills, **counts, "problems": _problems(folder)}))


def _problems(folder: Path) -> list[str]:
    problems = [path.read_text() for path in folder.glob("died-*")]
    if (folder / "problems").exists():
        problems += (folder / "problems").read_text().splitlines()
    cache = InputCache(folder / "cache", 10**9)
    target = folder / "target"
    for file, data in _FILES.items():
        if cache.place(file, [target]) and target.read_bytes() != data:
            problems.append(f"a sealed file is wrong: {file.sha256}")
        cache.get(file, _fetch_the_rest, lambda _: sys.exit("a lock is stuck"))
        if not cache.place(file, [target]) or target.read_bytes() != data:
            problems.append(f"a file cannot be had any more: {file.sha256}")
    target.unlink()
    # Nobody uses anything: all of it can be removed, after a day also seals without their files.
    InputCache(folder / "cache", 0)
    for seal in (folder / "cache").glob("*.seal"):
        os.utime(seal, (0, 0))
    InputCache(folder / "cache", 0)
    left = [path.name for path in (folder / "cache").iterdir() if path.name != "lock"]
    return problems + [f"left: {name}" for name in left]


def _fetch_the_rest(part: PartialInput) -> None:
    part.add(_FILES[part.file][part.offset :])


def _lines(path: Path) -> int:
    return len(path.read_text().splitlines()) if path.exists() else 0


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]))
