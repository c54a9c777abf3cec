"""`make bench`: prints the table of first measures and writes it as JSON beside it (`.bench/results.json`)."""

import json
import os
import shutil
import signal
import statistics
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from benchmarks.claims import claims_row
from benchmarks.index_bytes import index_bytes
from benchmarks.measure import Pairing, Run, pair, run_side
from benchmarks.recordings import recording_rows
from benchmarks.rights import rights_row
from benchmarks.runs import run_rows
from benchmarks.scale.rows import scale_rows, small_files
from benchmarks.signing_in import sign_in_row
from benchmarks.web import web_rows
from kleinkram.recordings.sample import generate_bag, generate_mcap

ROOT = Path(__file__).resolve().parent.parent
STAGE = ROOT / ".bench"
DATA = STAGE / "data"
KLEIN = Path(sys.executable).parent / "klein"
GB = 1_000_000_000
ROWS = {
    "memory",
    "transfers",
    "small",
    "summaries",
    "recordings",
    "starts",
    "people",
    "rights",
    "web",
    "runs",
    "claims",
    "scale",
}
# How many times 200 000 files there are, in turn.
SIZES = [int(size) for size in os.environ.get("KLEINKRAM_BENCH_SCALE", "1,10").split(",")]
STARTS = int(os.environ.get("KLEINKRAM_BENCH_STARTS", "30"))


def main() -> None:
    """Measure the rows that are named (`python -m benchmarks small starts`), or everything; print the table."""
    wanted = set(sys.argv[1:]) or ROWS
    if unknown := wanted - ROWS:
        raise SystemExit(f"no rows called {', '.join(sorted(unknown))}; there are {', '.join(sorted(ROWS))}")
    shutil.rmtree(STAGE, ignore_errors=True)
    STAGE.mkdir()
    rows: list[dict[str, object]] = []
    if wanted != {"recordings"}:
        with instance():
            klein("project", "create", "bench")
    if "memory" in wanted:
        with instance():
            rows.append(memory_row())
    if wanted & {"transfers", "small", "summaries"}:
        rows += rows_of_an_instance(wanted)
    if "people" in wanted:
        with instance():
            rows.append(sign_in_row(told()["url"], (DATA / "owner-token").read_text().strip()))
    if "recordings" in wanted:
        rows += recording_rows(STAGE / "recordings")
    if "starts" in wanted:
        rows += start_rows()
    if "rights" in wanted:  # it leaves much behind
        with instance() as environment:
            owner_token = (DATA / "owner-token").read_text().strip()
            rows.append(rights_row(told()["url"], owner_token, environment["KLEINKRAM_DATABASE_URL"]))
    if wanted & {"runs", "claims"}:
        rows += rows_of_runs(wanted)
    if "web" in wanted:
        rows += rows_of_the_web()
    if "scale" in wanted:
        for size in SIZES:
            rows += rows_of_a_size(size)
    (STAGE / "results.json").write_text(json.dumps(rows, indent=1) + "\n")
    print_table(rows)


def rows_of_an_instance(wanted: set[str]) -> list[dict[str, object]]:
    """Measure against one instance."""
    rows: list[dict[str, object]] = []
    with instance() as environment:
        if "transfers" in wanted:
            rows += [upload_row(environment), download_row(environment)]
        if "small" in wanted:
            rows.append(small_files_row(environment))
        if "summaries" in wanted:
            rows += summary_rows(environment)
    return rows


def rows_of_runs(wanted: set[str]) -> list[dict[str, object]]:
    """Measure runs and claims, on an instance of their own."""
    shutil.rmtree(DATA, ignore_errors=True)
    rows: list[dict[str, object]] = []
    with instance() as environment:
        klein("project", "create", "bench")
        owner_token = (DATA / "owner-token").read_text().strip()
        if "runs" in wanted:
            rows += run_rows(told()["url"], owner_token, STAGE / "runs", mission_with)
        if "claims" in wanted:
            mission_id = mission_with("claims", random_file(STAGE / "claims.bin", 1000))
            rows.append(claims_row(told()["url"], owner_token, environment["KLEINKRAM_DATABASE_URL"], mission_id))
    return rows


def rows_of_a_size(size: int) -> list[dict[str, object]]:
    """Measure an instance filled to a size."""
    shutil.rmtree(DATA, ignore_errors=True)
    with instance() as environment:
        owner_token = (DATA / "owner-token").read_text().strip()
        secret = json.loads((DATA / "secrets.json").read_text())["postgres_migrate"]
        address = environment["KLEINKRAM_DATABASE_URL"].split("@", 1)[1]
        owner_url = f"postgresql://kleinkram_migrate:{secret}@{address}"
        rows = scale_rows(size, told()["url"], owner_token, environment, owner_url=owner_url)
        if size == 1:
            rows += many_small_rows(environment)
    return rows


def many_small_rows(environment: dict[str, str]) -> list[dict[str, object]]:
    """10 000 files of 10 kB in one mission, up and down."""
    klein("project", "create", "bench")
    number = 0

    def fresh() -> Path:
        nonlocal number
        number += 1
        folder = small_files(STAGE / f"many-{number}", 10_000, 10_000)
        klein("mission", "create", folder.name, "-p", "bench")
        return folder

    def up() -> Run:
        folder = fresh()
        return run_side("upload_ours", "bench", folder.name, str(folder), environment=environment)

    def up_raw() -> Run:
        return run_side("upload_raw", *sorted(map(str, fresh().iterdir())), environment=environment)

    pairing = pair(up, up_raw, pairs=2)
    settle()

    def down(name: str) -> Run:
        destination = STAGE / "many-down"
        shutil.rmtree(destination, ignore_errors=True)
        destination.mkdir()
        return run_side(name, "many-1", str(destination), environment=environment)

    back = pair(lambda: down("download_ours"), lambda: down("download_raw"), pairs=2)
    return [
        ratio_row("10 000 files of 10 kB up", pairing, 0.5),
        ratio_row("10 000 files of 10 kB down, verified", back, 0.5),
    ]


def mission_with(name: str, source: Path) -> str:
    """Upload a file into a new mission; returns the mission's id."""
    klein("upload", "-p", "bench", "-m", name, "--create", str(source))
    settle()
    found = json.loads(klein("mission", "info", name, "-p", "bench", "--json"))
    return str(found["mission"]["id"])


def rows_of_the_web() -> list[dict[str, object]]:
    """Measure the web interface, on an instance of its own."""
    shutil.rmtree(DATA, ignore_errors=True)
    folder = STAGE / "web"
    with instance() as environment:
        owner_token = (DATA / "owner-token").read_text().strip()
        return web_rows(klein, told()["url"], owner_token, environment["KLEINKRAM_DATABASE_URL"], folder)


def variables() -> dict[str, str]:
    """Return the environment of everything that runs here."""
    homes = {name: str(STAGE / name.lower()) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME")}
    # Proving goes at full speed between two runs, rather than slowly beside them;
    # and nobody is asked to wait for having asked too often.
    limits = ("SIGN_INS", "SEARCHES")
    unbounded = {f"KLEINKRAM_{what}_PER_MINUTE": "0" for what in limits}
    at_once = {"KLEINKRAM_PROVING_BYTES_PER_S": "2000000000"}
    return {**os.environ, **homes, **at_once, **unbounded, "KLEINKRAM_DATA_DIR": str(DATA)}


def klein(*arguments: str) -> str:
    """Run one command."""
    command = [str(KLEIN), *arguments]
    return subprocess.run(command, env=variables(), check=True, stdout=subprocess.PIPE, text=True).stdout


@contextmanager
def instance() -> Iterator[dict[str, str]]:
    """Run an instance; yields the environment by which a side reaches API and store."""
    process = subprocess.Popen([str(KLEIN), "up"], env=variables(), stdout=subprocess.PIPE, text=True)
    try:
        if not (process.stdout and process.stdout.readline()):
            raise SystemExit("Kleinkram did not start")
        worker = psutil.Process(told()["parts"]["worker"])
        inherited = {key: value for key, value in worker.environ().items() if key.startswith("KLEINKRAM_")}
        yield {**variables(), **inherited}
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=60)


def told() -> dict[str, Any]:
    """Return what the instance says of itself."""
    facts: dict[str, Any] = json.loads((DATA / "instance.json").read_text())
    return facts


def settle() -> None:
    """Wait until no job waits or runs, so that nothing runs beside a measurement."""
    while True:
        with urllib.request.urlopen(f"{told()['url']}/metrics", timeout=10) as answer:
            lines = answer.read().decode().splitlines()
        busy = [
            line for line in lines if line.startswith("kleinkram_jobs{") and ('"todo"' in line or '"doing"' in line)
        ]
        if (
            sum(float(line.rsplit(" ", 1)[1]) for line in busy if "finish_uploads" not in line and "sweep" not in line)
            == 0
        ):
            return
        time.sleep(0.2)


def random_file(path: Path, size_bytes: int) -> Path:
    """Write a file of bytes that are nobody's."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        for start in range(0, size_bytes, 1 << 24):
            stream.write(os.urandom(min(1 << 24, size_bytes - start)))
    # An hour old: of files written just now, an upload waits to see whether they still grow.
    os.utime(path, (time.time() - 3600, time.time() - 3600))
    return path


def upload_row(environment: dict[str, str]) -> dict[str, object]:
    """1 GB up. Sizes differ by some bytes from run to run, so that no run finds a twin of the last one."""
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
    return ratio_row("1 GB up, hashed and proven by the store", pairing, 0.9) | {
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
    """The summaries of a 1 GB MCAP and a 1 GB bag over HTTP."""
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
    return rows


def memory_row() -> dict[str, object]:
    """Memory of everything, after 1 GB came and went."""
    source = random_file(STAGE / "gigabyte" / "memory.bin", GB)
    klein("upload", "-p", "bench", "-m", "memory", "--create", str(source))
    settle()
    klein("download", "-p", "bench", "-m", "memory", "--dest", str(STAGE / "memory"))
    supervisor = psutil.Process(told()["pid"])
    by_part = {"supervisor": pss_mb(supervisor)}
    for name, pid in told()["parts"].items():
        part = psutil.Process(pid)
        by_part[name] = sum(map(pss_mb, [part, *part.children(recursive=True)]))
    total = sum(by_part.values())
    return {
        "what": "memory of everything (PSS) after 1 GB up and down",
        "measured": f"{total:.0f} MB",
        "bar": "<= 600 MB",
        "met": total <= 600,
        "parts_mb": by_part,
        "also": ", ".join(f"{name} {size:.0f}" for name, size in sorted(by_part.items(), key=lambda item: -item[1])),
    }


def pss_mb(process: psutil.Process) -> float:
    """Return a process's share of the memory it uses, in MB."""
    return float(process.memory_full_info().pss / 1e6)


def start_rows() -> list[dict[str, object]]:
    """Warm starts: from the command to the first answer, and to the first real PUT."""
    small = random_file(STAGE / "put.bin", 1000)
    answers, puts = [], []
    for number in range(STARTS):
        started = time.perf_counter()
        with instance():
            urllib.request.urlopen(f"{told()['url']}/health/ready", timeout=10).close()
            answers.append(time.perf_counter() - started)
            os.truncate(small, 1000 + number)
            os.utime(small, (time.time() - 3600, time.time() - 3600))
            klein("upload", "-p", "bench", "-m", "starts", "--create", str(small), "--json")
            puts.append(time.perf_counter() - started)
            klein("file", "delete", "put.bin", "-p", "bench", "-m", "starts", "--yes")
    return [
        {
            "what": f"warm `klein up` to {what}, {STARTS} starts",
            "measured": f"median {statistics.median(seconds):.2f} s, slowest {max(seconds):.2f} s",
            "bar": "<= 5 s each time",
            "met": max(seconds) <= 5,
            "seconds": seconds,
        }
        for what, seconds in (("the first answer", answers), ("the first real PUT (by a new client)", puts))
    ]


def print_table(rows: list[dict[str, object]]) -> None:
    """Print the table as Markdown."""
    print("| what | measured | bar | met |\n|---|---|---|---|")
    for row in rows:
        also = f"; {row['also']}" if "also" in row else ""
        print(f"| {row['what']} | {row['measured']}{also} | {row['bar']} | {'yes' if row['met'] else 'NO'} |")


if __name__ == "__main__":
    main()
