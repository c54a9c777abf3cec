"""Files up and down, large and small, and their summaries over HTTP, each compared with the minimum."""

import itertools
import os
import shutil
import statistics
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from benchmarks.index_bytes import index_bytes
from benchmarks.instance import DATA, GB, STAGE, endpoint_info, klein, settle
from benchmarks.measure import Pairing, Run, pair, run_side
from benchmarks.scale.rows import small_files
from benchmarks.sides import link_of
from benchmarks.slices import cut_stored_row
from kleinkram.recordings.sample import generate_bag, generate_mcap

_SMALL_ROUNDS = 3


def random_file(path: Path, size_bytes: int) -> Path:
    """Write a file of random bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        for start in range(0, size_bytes, 1 << 24):
            stream.write(os.urandom(min(1 << 24, size_bytes - start)))
    # An hour old: an upload waits until recently written files stop growing.
    os.utime(path, (time.time() - 3600, time.time() - 3600))
    return path


def upload_row(environment: dict[str, str]) -> dict[str, object]:
    """1 GB up. Sizes differ by some bytes from run to run, so that no run uploads a duplicate of the last one."""
    source = random_file(STAGE / "large" / "large.bin", GB)
    number = 0

    def ours() -> Run:
        nonlocal number
        number += 1
        os.truncate(source, GB + number)
        os.utime(source, (time.time() - 3600, time.time() - 3600))
        klein("mission", "create", f"up-{number}", "-p", "bench")
        run = run_side("upload_ours", "bench", f"up-{number}", str(source), environment=environment)
        settle()
        return run

    def raw() -> Run:
        return run_side("upload_raw", str(source), environment=environment)

    pairing = pair(ours, raw)
    cpu, peak = pairing.median(lambda run: run.cpu_s), pairing.median(lambda run: run.peak_mb)
    return ratio_row("1 GB up, hashed and verified by the store", pairing, 0.9) | {
        "client_cpu_s_per_gb": cpu,
        "client_peak_mb": peak,
        "also": f"client {cpu:.2f} CPU s/GB (bar 1.6), {peak:.0f} MB (bar 200)",
        "met": pairing.ratio >= 0.9 and cpu <= 1.6 and peak <= 200,
    }


def download_row(environment: dict[str, str]) -> dict[str, object]:
    """1 GB down."""
    destination = STAGE / "down"

    def side(name: str) -> Run:
        shutil.rmtree(destination, ignore_errors=True)
        destination.mkdir()
        return run_side(name, "up-1", str(destination), environment=environment)

    pairing = pair(lambda: side("download_ours"), lambda: side("download_raw"))
    cpu = pairing.median(lambda run: run.cpu_s - run.facts["verify_cpu_s"])
    alone = pairing.median(lambda run: run.facts["verify_s"])
    return ratio_row("1 GB down, verified", pairing, 0.7) | {
        "client_cpu_s_per_gb": cpu,
        "verify_s": alone,
        "also": f"client {cpu:.2f} CPU s/GB; verifying, which runs beside fetching, takes {alone:.2f} s by itself; "
        "both sides force the file to disk",
    }


def small_files_row(environment: dict[str, str]) -> dict[str, object]:
    """500 files of 1 MB up."""
    number = 0

    def fresh() -> Path:
        nonlocal number
        number += 1
        folder = STAGE / f"small-{number}"
        for index in range(500):
            random_file(folder / f"{index:03}.bin", 1_000_000)
        klein("mission", "create", f"small-{number}", "-p", "bench")
        return folder

    def ours() -> Run:
        folder = fresh()
        run = run_side("upload_ours", "bench", folder.name, str(folder), environment=environment)
        settle()
        return run

    def raw() -> Run:
        folder = fresh()
        return run_side("upload_raw", *sorted(map(str, folder.iterdir())), environment=environment)

    pairing = pair(ours, raw)
    return ratio_row("500 files of 1 MB up", pairing, 0.6)


def ratio_row(what: str, pairing: Pairing, bar: float) -> dict[str, object]:
    """Return one row of the table about a ratio."""
    ours = statistics.median(run.seconds for run in pairing.ours)
    raw = statistics.median(run.seconds for run in pairing.raw)
    return {
        "what": what,
        "measured": f"{pairing.ratio:.2f} of raw (ours {ours:.2f} s, raw {raw:.2f} s)",
        "bar": f">= {bar} of raw",
        "met": pairing.ratio >= bar,
        "ratio": pairing.ratio,
        "ours_s": [run.seconds for run in pairing.ours],
        "raw_s": [run.seconds for run in pairing.raw],
    }


def summary_rows(environment: dict[str, str]) -> list[dict[str, object]]:
    """The summaries of a 1 GB MCAP and a 1 GB bag over HTTP, and a slice of the MCAP."""
    folder = STAGE / "recordings"
    folder.mkdir(exist_ok=True)
    generate_mcap(folder / "large.mcap", size_bytes=GB, seed=1)
    generate_bag(folder / "large.bag", size_bytes=GB, seed=2)
    klein("mission", "create", "summaries", "-p", "bench")
    klein("upload", "-p", "bench", "-m", "summaries", *map(str, sorted(folder.iterdir())))
    settle()
    rows = []
    for path in sorted(folder.iterdir()):
        ours, raw = (
            partial(run_side, name, "summaries", path.name, environment=environment)
            for name in ("summary_remote", "summary_raw")
        )
        pairing = pair(ours, raw)
        seconds, read = pairing.median(lambda run: run.seconds), pairing.ours[0].facts["bytes_read"]
        raw_s = statistics.median(run.seconds for run in pairing.raw)
        allowed = index_bytes(path) + 1_000_000
        rows.append(
            {
                "what": f"summary of a 1 GB {path.suffix[1:]} over HTTP",
                "measured": f"{seconds:.2f} s, {read / 1e6:.2f} MB read; the store alone takes {raw_s:.2f} s for it",
                "bar": f"<= 1.5 s, <= {allowed / 1e6:.2f} MB (index + 1 MB)",
                "met": seconds <= 1.5 and read <= allowed,
                "ours_s": [run.seconds for run in pairing.ours],
                "raw_s": [run.seconds for run in pairing.raw],
                "bytes_read": read,
            }
        )
    token = (DATA / "owner-token").read_text().strip()
    return [
        *rows,
        cut_stored_row(folder / "large.mcap", link_of("summaries", "large.mcap", endpoint_info()["url"], token).url),
    ]


def many_small_rows(label: str, environment: dict[str, str]) -> Iterator[dict[str, object]]:
    """10 000 files of 10 kB in one mission, up and down."""
    klein("project", "create", "bench")

    def fresh(name: str) -> Path:
        klein("mission", "create", name, "-p", "bench")
        return small_files(STAGE / name, 10_000, 10_000)

    def up_raw(name: str) -> Run:
        return run_side("upload_raw", *sorted(map(str, fresh(name).iterdir())), environment=environment)

    # Plain requests before and after each run, once no job of ours is left to slow them down.
    raw, ours = [up_raw("raw-0")], []
    for number in range(1, _SMALL_ROUNDS + 1):
        name = f"many-{number}"
        ours.append(run_side("upload_ours", "bench", name, str(fresh(name)), environment=environment))
        settle()
        raw.append(up_raw(f"raw-{number}"))
    around = (statistics.mean(run.seconds for run in both) for both in itertools.pairwise(raw))
    ratio = statistics.median(bare / run.seconds for bare, run in zip(around, ours, strict=True))
    yield ratio_row(f"{label}: 10 000 files of 10 kB up", Pairing(ours, raw, ratio), 0.5)

    def down(name: str) -> Run:
        destination = STAGE / "many-down"
        shutil.rmtree(destination, ignore_errors=True)
        destination.mkdir()
        return run_side(name, "many-1", str(destination), environment=environment)

    back = pair(lambda: down("download_ours"), lambda: down("download_raw"), pairs=_SMALL_ROUNDS)
    yield ratio_row(f"{label}: 10 000 files of 10 kB down, verified", back, 0.5)
