"""The rows about packages of scripts: the start of a script with evo and what it needs, installed and cached.

Needs a package index: `KLEINKRAM_PACKAGE_INDEX`, else PyPI; says so where none answers.
"""

import statistics
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

from kleinkram.contract.actions import ActionDefinition, Network, Resources
from kleinkram.contract.isolation import Isolation
from kleinkram.environments.local import local_index
from kleinkram.environments.lock import CannotLock, lock_dependencies
from kleinkram.runner.executors.base import LockedScript, RunJob, wait_for_end
from kleinkram.runner.executors.local import Machine, MachineShare
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.inputs import command_of

_PAIRS = 8
_SCRIPT = "print('hello')\n"


def package_rows(folder: Path) -> Iterator[dict[str, object]]:
    """Measure how long the packages of evo take: the first time, and from then on."""
    folder.mkdir(parents=True)
    index = local_index()
    executor = ProcessExecutor(Machine(folder, MachineShare(cores=1), index))
    try:
        lock = lock_dependencies(["evo==1.38.1"], index, time.sleep, requires_python=">=3.11") if index else None
    except CannotLock as error:
        lock = None
        print(f"No row about packages: {error}", flush=True)
    if lock is None:
        return
    script = LockedScript(lock, ">=3.11", None)
    shown: list[tuple[str, float]] = []
    started = time.perf_counter()
    executor.place_environment(script, wait=time.sleep, show=lambda *progress: shown.append(progress)).close()
    built_s = time.perf_counter() - started
    fractions = sorted({fraction for _, fraction in shown})
    how = "namespaces" if executor.abilities.isolation is Isolation.namespaces else "no sandbox"
    yield {
        "what": "the first run with evo: its packages downloaded, unpacked and compiled",
        "measured": f"{built_s:.1f} s; {shown[0][0]!r}, {len(fractions)} times up to {fractions[-1]:.0%}",
        "bar": "shown with progress",
        "met": fractions[-1] > fractions[0],
    }
    with_packages, without = [], []
    for _ in range(_PAIRS):
        with_packages.append(_run(executor, folder, script))
        without.append(_run(executor, folder, None))
    more = statistics.median(with_packages) - statistics.median(without)
    yield {
        "what": f"a script with evo as dependency, cached, compared with one without ({how})",
        "measured": f"{more:.2f} s more ({statistics.median(with_packages):.2f} s, {statistics.median(without):.2f} s)",
        "bar": "<= 1 s more",
        "met": more <= 1,
        "seconds": with_packages,
        "without_s": without,
    }


def _run(executor: ProcessExecutor, folder: Path, script: LockedScript | None) -> float:
    """Return the seconds from the assignment of a run to its end."""
    directory = folder / "runs" / uuid.uuid4().hex
    (directory / "in" / ".kleinkram").mkdir(parents=True)
    (directory / "in" / ".kleinkram" / "script.py").write_text(_SCRIPT)
    dependencies = ["evo==1.38.1"] if script else []
    action = ActionDefinition(name="bench", script=_SCRIPT, dependencies=dependencies)
    network = Network.none if executor.abilities.isolation is Isolation.namespaces else Network.open
    started = time.perf_counter()
    environment = executor.place_environment(script, wait=time.sleep, show=lambda *_: None) if script else None
    job = RunJob(
        key=directory.name,
        directory=directory,
        command=command_of(action, in_image=False),
        image=None,
        resources=Resources(),
        network=network,
        packages=environment.packages if environment else None,
    )
    executor.submit(job)
    ending = wait_for_end(executor, job, 60)
    seconds = time.perf_counter() - started
    if ending is None or ending.exit_code != 0:
        raise SystemExit(f"not a good run: {ending} {(directory / 'log').read_text()}")
    executor.remove(job)
    if environment is not None:
        environment.close()
    return seconds
