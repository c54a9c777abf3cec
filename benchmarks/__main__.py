"""`make bench`: runs the benchmarks, prints a table, and writes it as JSON (`.bench/results.json`)."""

import json
import os
import shutil
import statistics
import sys
import time
import urllib.request
from collections.abc import Iterator

import psutil

from benchmarks.checks import check_rows
from benchmarks.claims import claims_row
from benchmarks.cluster import cluster_rows
from benchmarks.instance import DATA, GB, STAGE, endpoint_info, instance, klein, mission_with, settle
from benchmarks.packages import package_rows
from benchmarks.previews import preview_rows
from benchmarks.recording_previews import recording_preview_rows
from benchmarks.recordings import recording_rows
from benchmarks.rights import rights_row
from benchmarks.runs import run_rows
from benchmarks.scale.rows import load_rows, scale_rows, scrape_row, size_label
from benchmarks.shared_inputs import shared_inputs_row
from benchmarks.signing_in import sign_in_row
from benchmarks.slurm import slurm_rows
from benchmarks.traces import traces_row
from benchmarks.transfers import download_row, many_small_rows, random_file, small_files_row, summary_rows, upload_row
from benchmarks.web import web_rows

Row = dict[str, object]
ROWS = {
    "memory",
    "transfers",
    "small",
    "summaries",
    "recordings",
    "checks",
    "packages",
    "previews",
    "recording_previews",
    "starts",
    "people",
    "rights",
    "web",
    "runs",
    "claims",
    "shared",
    "cluster",
    "slurm",
    "traces",
    "scale",
}
# Sizes of the scale benchmark, in multiples of 200,000 files.
SIZES = [int(size) for size in os.environ.get("KLEINKRAM_BENCH_SCALE", "1,10").split(",")]
STARTS = int(os.environ.get("KLEINKRAM_BENCH_STARTS", "30"))


def main() -> None:
    """Run the named benchmarks (`python -m benchmarks small starts`) or all, and print each row as it is measured."""
    selected = set(sys.argv[1:]) or ROWS
    if unknown := selected - ROWS:
        raise SystemExit(f"no rows called {', '.join(sorted(unknown))}; there are {', '.join(sorted(ROWS))}")
    shutil.rmtree(STAGE, ignore_errors=True)
    STAGE.mkdir()
    rows: list[Row] = []
    print("| what | measured | bar | met |\n|---|---|---|---|", flush=True)
    for row in measured(selected):
        also = f"; {row['also']}" if "also" in row else ""
        cells = f"{row['measured']}{also} | {row['bar']} | {'yes' if row['met'] else 'NO'}"
        print(f"| {row['what']} | {cells} |", flush=True)
        rows.append(row)
        (STAGE / "results.json").write_text(json.dumps(rows, indent=1) + "\n")


def measured(selected: set[str]) -> Iterator[Row]:
    """Yield the selected rows when they are measured."""
    if selected - {"recordings", "checks", "packages", "previews", "recording_previews", "slurm"}:
        with instance():
            klein("project", "create", "bench")
    if "memory" in selected:
        with instance():
            yield memory_row()
    if selected & {"transfers", "small", "summaries"}:
        yield from rows_of_an_instance(selected)
    if "people" in selected:
        with instance():
            yield sign_in_row(endpoint_info()["url"], (DATA / "owner-token").read_text().strip())
    if "traces" in selected:
        with instance() as environment:
            yield traces_row(environment, (DATA / "owner-token").read_text().strip())
    if "recordings" in selected:
        yield from recording_rows(STAGE / "recordings")
    if "checks" in selected:
        yield from check_rows(STAGE / "checks")
    if "packages" in selected:
        yield from package_rows(STAGE / "packages")
    if "previews" in selected:
        yield from preview_rows(STAGE / "previews")
    if "recording_previews" in selected:
        yield from recording_preview_rows(STAGE / "recording-previews")
    if "starts" in selected:
        yield from start_rows()
    if "rights" in selected:  # it leaves much behind
        with instance() as environment:
            owner_token = (DATA / "owner-token").read_text().strip()
            yield rights_row(endpoint_info()["url"], owner_token, environment["KLEINKRAM_DATABASE_URL"])
    if selected & {"runs", "claims", "shared"}:
        yield from rows_of_runs(selected)
    if "cluster" in selected:
        yield from rows_of_a_cluster()
    if "slurm" in selected:
        yield from slurm_rows(STAGE / "slurm")
    if "web" in selected:
        yield from rows_of_the_web()
    if "scale" in selected:
        for size in SIZES:
            yield from rows_of_a_size(size)


def rows_of_an_instance(selected: set[str]) -> Iterator[Row]:
    """Measure against one instance."""
    with instance() as environment:
        if "transfers" in selected:
            yield upload_row(environment)
            yield download_row(environment)
        if "small" in selected:
            yield small_files_row(environment)
        if "summaries" in selected:
            yield from summary_rows(environment)


def rows_of_runs(selected: set[str]) -> Iterator[Row]:
    """Measure runs and claims, on an instance of their own."""
    shutil.rmtree(DATA, ignore_errors=True)
    with instance() as environment:
        klein("project", "create", "bench")
        owner_token = (DATA / "owner-token").read_text().strip()
        if "runs" in selected:
            yield from run_rows(endpoint_info()["url"], owner_token, STAGE / "runs", mission_with)
        if "claims" in selected:
            mission_id = mission_with("claims", random_file(STAGE / "claims.bin", 1000))
            yield claims_row(endpoint_info()["url"], owner_token, environment["KLEINKRAM_DATABASE_URL"], mission_id)
        if "shared" in selected:
            store = psutil.Process(endpoint_info()["services"]["store"])
            yield shared_inputs_row(endpoint_info()["url"], owner_token, store, STAGE / "shared", mission_with)


def rows_of_a_cluster() -> Iterator[Row]:
    """Measure a simulated cluster, on an instance of its own."""
    shutil.rmtree(DATA, ignore_errors=True)
    with instance() as environment:
        klein("project", "create", "bench")
        owner_token = (DATA / "owner-token").read_text().strip()
        mission_id = mission_with("cluster", random_file(STAGE / "cluster.bin", 1000))
        yield from cluster_rows(endpoint_info()["url"], owner_token, environment["KLEINKRAM_DATABASE_URL"], mission_id)


def rows_of_a_size(size: int) -> Iterator[Row]:
    """Measure an instance filled to a size."""
    shutil.rmtree(DATA, ignore_errors=True)
    with instance() as environment:
        owner_token = (DATA / "owner-token").read_text().strip()
        secret = json.loads((DATA / "secrets.json").read_text())["postgres_migrate"]
        address = environment["KLEINKRAM_DATABASE_URL"].split("@", 1)[1]
        owner_url = f"postgresql://kleinkram_migrate:{secret}@{address}"
        yield from scale_rows(size, endpoint_info()["url"], owner_token, environment, owner_url=owner_url)
        yield scrape_row(size, endpoint_info()["ports"]["api_metrics"])
        yield from many_small_rows(size_label(size), environment)
        settle()
        yield from load_rows(size, endpoint_info()["url"], owner_token, environment)


def rows_of_the_web() -> list[Row]:
    """Measure the web interface, on an instance of its own."""
    shutil.rmtree(DATA, ignore_errors=True)
    folder = STAGE / "web"
    with instance() as environment:
        owner_token = (DATA / "owner-token").read_text().strip()
        return web_rows(klein, endpoint_info()["url"], owner_token, environment["KLEINKRAM_DATABASE_URL"], folder)


def memory_row() -> Row:
    """Memory of all processes, after an upload and a download of 1 GB."""
    source = random_file(STAGE / "gigabyte" / "memory.bin", GB)
    klein("upload", "-p", "bench", "-m", "memory", "--create", str(source))
    settle()
    klein("download", "-p", "bench", "-m", "memory", "--dest", str(STAGE / "memory"))
    supervisor = psutil.Process(endpoint_info()["pid"])
    by_part = {"supervisor": pss_mb(supervisor)}
    for name, pid in endpoint_info()["services"].items():
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


def start_rows() -> list[Row]:
    """Warm starts: from the command to the first answer, and to the first real PUT."""
    small = random_file(STAGE / "put.bin", 1000)
    answers, puts = [], []
    for number in range(STARTS):
        started = time.perf_counter()
        with instance():
            urllib.request.urlopen(f"{endpoint_info()['url']}/health/ready", timeout=10).close()
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


if __name__ == "__main__":
    main()
