"""Runs an action on this machine, for its author: with the same `/in` and `/out` as on a runner of a server."""

import contextlib
import dataclasses
import shutil
import tempfile
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from kleinkram.checks.document import read_checks, reference_of
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.transfer import Watcher, download, plan_download
from kleinkram.contract.actions import ActionDefinition, Inputs, ParameterValues
from kleinkram.contract.errors import YamlInvalid
from kleinkram.contract.files import FileFilter, FileRead
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.runs import ActionRef, Cause, EndReason, RunChecks, RunContext
from kleinkram.runner.executors.base import CannotStart, Ending, Executor, LockedScript, RunJob, wait_for_end
from kleinkram.runner.inputs import check_input_path, command_of, write_context
from kleinkram.runner.results import Results, collect_results

_CHECK_EVERY_S = 0.05
_READ_BYTES = 65536


@dataclass(frozen=True)
class LocalRun:
    """End of a local run, with its results in `out`."""

    ending: Ending
    results: Results
    out: Path


def run_locally(
    client: Client,
    action: ActionDefinition,
    mission: MissionRead,
    parameter_values: ParameterValues,
    *,
    executor: Executor,
    out: Path,
    show: Callable[[bytes], None],
    watcher: Watcher,
) -> LocalRun:
    """Run an action on a mission: download its inputs, show its output, and copy its results to `out`, which is empty.

    The packages of its lock are installed first, with a line about it in the output.

    Raises:
        InvalidInput: a parameter is invalid, or `out` is not empty.
        NothingToDo: no file of the mission is an input.
        FileUnavailable, TransferFailed, …: as `download`.
    """
    try:
        parameters = action.fill_in(parameter_values)
    except ValueError as error:
        raise InvalidInput(what="The parameters", reason=str(error)) from error
    if out.exists() and any(out.iterdir()):
        raise InvalidInput(what=f"The folder {str(out)!r}", reason="it is not empty")
    with tempfile.TemporaryDirectory(prefix="klein-run-") as name:
        directory = Path(name)
        # Some executors run the job as another user.
        directory.chmod(0o711)
        (directory / "in").mkdir()
        files = _download_inputs(client, action, mission, directory / "in", watcher)
        checks = _checks_of(client, mission, action.inputs)
        context = RunContext(
            run_id=None,
            action=ActionRef(name=action.name, version=None),
            parameters=parameters,
            cause=Cause(person=client.me.get().person),
            mission=mission,
            files=files,
            topics=[topic for file in files for topic in client.files.topics(file.id)],
            recordings=list(client.recordings.list(mission.id)),
            checks=checks if action.inputs.checks else None,
            reference=_reference_of(checks, mission) if action.inputs.reference else None,
        )
        write_context(directory / "in", context, action.script)
        command = command_of(action, in_image=action.image is not None)
        key = f"local-{uuid.uuid4().hex[:12]}"
        job = RunJob(key, directory, command, action.image, action.resources, action.network)
        ending = _run_with_packages(executor, job, action, show)
        results = collect_results(executor.collect(job))
        for artifact in results.artifacts:
            target = out / artifact.path
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(executor.collect(job) / artifact.path, target, follow_symlinks=False)
    if results.report_error is not None and ending.reason is EndReason.done:
        ending = Ending(EndReason.broken_report, results.report_error, ending.exit_code)
    results.report = results.final_report(ending.reason)
    return LocalRun(ending, results, out)


def _checks_of(client: Client, mission: MissionRead, inputs: Inputs) -> RunChecks | None:
    if not (inputs.checks or inputs.reference):
        return None
    checks = client.checks.get(mission.project.id)
    return RunChecks(version=checks.number, sha256=checks.sha256, text=checks.text) if checks.text else None


def _reference_of(checks: RunChecks | None, mission: MissionRead) -> str | None:
    try:
        return reference_of(read_checks(checks.text) if checks else None, mission.metadata)
    except YamlInvalid as error:
        raise InvalidInput(what=f"The checks.yaml of {mission.project.name}", reason=error.sentence()) from error


def _download_inputs(
    client: Client, action: ActionDefinition, mission: MissionRead, directory: Path, watcher: Watcher
) -> list[FileRead]:
    inputs = action.inputs
    matching = FileFilter(
        mission_id=mission.id, path=inputs.paths, topic=inputs.topics, message_type=inputs.message_types
    )
    files = [file for file in client.files.list(matching) if inputs.derived or not file.is_derived]
    if not files:
        raise NothingToDo(reason=f"No file of the mission {mission.name} is an input of {action.name}")
    for file in files:
        try:
            check_input_path(file.path)
        except ValueError as error:  # noqa: PERF203  (each error names its file)
            raise InvalidInput(what=f"The file {file.path}", reason=str(error)) from None
    report = download(client, plan_download(files, directory), watcher=watcher)
    for failure in [*report.failures, *report.left_out]:
        raise failure
    for path in directory.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o444)
    return files


def _run_with_packages(
    executor: Executor, job: RunJob, action: ActionDefinition, show: Callable[[bytes], None]
) -> Ending:
    if action.lock is None:
        return _run(executor, job, show)
    shown: set[str] = set()

    def show_once(message: str, _: float) -> None:
        if message not in shown:
            shown.add(message)
            show(f"{message}.\n".encode())

    script = LockedScript(action.lock, action.requires_python, action.image)
    try:
        environment = executor.place_environment(script, wait=time.sleep, show=show_once)
    except CannotStart as error:
        return error.ending
    with contextlib.closing(environment):
        return _run(executor, dataclasses.replace(job, packages=environment.packages), show)


def _run(executor: Executor, job: RunJob, show: Callable[[bytes], None]) -> Ending:
    try:
        executor.submit(job)
    except CannotStart as error:
        return error.ending
    has_ended = threading.Event()
    log = threading.Thread(target=_show_log, args=(executor, job, has_ended, show))
    log.start()
    try:
        while True:
            ending = wait_for_end(executor, job, timeout_s=1.0)
            if ending is not None:
                return ending
    except KeyboardInterrupt:
        executor.cancel(job)
        return wait_for_end(executor, job, timeout_s=60) or Ending(EndReason.lost, "It could not be stopped.")
    finally:
        has_ended.set()
        log.join()
        executor.remove(job)


def _show_log(executor: Executor, job: RunJob, has_ended: threading.Event, show: Callable[[bytes], None]) -> None:
    offset = 0
    while True:
        is_complete = has_ended.is_set()
        while data := executor.read_log(job, offset, _READ_BYTES):
            offset += len(data)
            show(data)
        if is_complete:
            return
        has_ended.wait(_CHECK_EVERY_S)
