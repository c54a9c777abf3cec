"""An action on this machine, for who is writing it: the very same `/in` and `/out` as on a server's runner."""

import shutil
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.transfer import Watcher, download, plan_download
from kleinkram.contract.actions import ActionDefinition, ParameterValues
from kleinkram.contract.files import FileFilter, FileRead
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.runs import ActionRef, Cause, EndReason, RunContext
from kleinkram.runner.given import check_place, script_command, write_given
from kleinkram.runner.results import Results, collect
from kleinkram.runner.work import CannotStart, Ending, Executor, Work

_LOOK_EVERY_S = 0.05


@dataclass(frozen=True)
class LocalRun:
    """How a run on this machine ended, and what it left in `out`."""

    ending: Ending
    results: Results
    out: Path


def run_locally(
    client: Client,
    action: ActionDefinition,
    mission: MissionRead,
    given: ParameterValues,
    *,
    executor: Executor,
    out: Path,
    show: Callable[[bytes], None],
    watcher: Watcher,
) -> LocalRun:
    """Run an action on a mission here: fetch its files, start it, show what it writes, and leave its results in `out`.

    `out` is made, and may not hold anything yet.

    Raises:
        InvalidInput: a parameter is not what it should be; `out` is in use.
        NothingToDo: no file of the mission fits.
        FileUnavailable, TransferFailed, …: as `download`.
    """
    try:
        parameters = action.fill_in(given)
    except ValueError as error:
        raise InvalidInput(what="The parameters", reason=str(error)) from error
    if out.exists() and any(out.iterdir()):
        raise InvalidInput(what=f"The folder {str(out)!r}", reason="holds something already; results need an empty one")
    with _folder() as folder:
        files = matching_files(client, action, mission)
        if not files:
            raise NothingToDo(reason=f"No file of the mission {mission.name} is an input of {action.name}")
        for file in files:
            _check_place(file)
        _fetch(client, files, folder / "in", watcher)
        context = make_context(client, action, mission, files, parameters)
        write_given(folder / "in", context, action.script)
        ending = _run(executor, make_work(action, folder), show)
        results = collect(folder / "out")
        for artifact in results.artifacts:
            target = out / artifact.path
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / "out" / artifact.path, target, follow_symlinks=False)
    if results.broken is not None and ending.reason is EndReason.done:
        ending = Ending(EndReason.broken_report, results.broken, ending.exit_code)
    return LocalRun(ending, results, out)


def matching_files(client: Client, action: ActionDefinition, mission: MissionRead) -> list[FileRead]:
    """Return the files of a mission that an action gets, by their paths."""
    wanted = action.inputs
    chosen = FileFilter(
        mission_id=mission.id, path=wanted.paths, topic=wanted.topics, message_type=wanted.message_types
    )
    return list(client.files.list(chosen))


def make_context(
    client: Client,
    action: ActionDefinition,
    mission: MissionRead,
    files: list[FileRead],
    parameters: ParameterValues,
) -> RunContext:
    """Return what `/in/mission.json` says of a run that no server knows of."""
    return RunContext(
        run_id=None,
        action=ActionRef(name=action.name, version=None),
        parameters=parameters,
        cause=Cause(person=client.me.get().person),
        mission=mission,
        files=files,
        topics=[topic for file in files for topic in client.files.topics(file.id)],
        recordings=list(client.recordings.list(mission.id)),
    )


def make_work(action: ActionDefinition, folder: Path) -> Work:
    """Return what an executor is told of an action, a script's command included."""
    command = list(action.command)
    if action.script is not None:
        command = script_command(action.dependencies, in_image=action.image is not None)
    key = f"local-{uuid.uuid4().hex[:12]}"
    return Work(key, folder, command, action.image, action.resources, action.network)


def _check_place(file: FileRead) -> None:
    try:
        check_place(file.path)
    except ValueError as error:
        raise InvalidInput(what=f"The file {file.path}", reason=str(error)) from None


def _fetch(client: Client, files: list[FileRead], folder: Path, watcher: Watcher) -> None:
    plan = plan_download(files, folder)
    report = download(client, plan, watcher=watcher)
    for failure in [*report.failures, *report.left_out]:
        raise failure
    for path in folder.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o444)


def _run(executor: Executor, work: Work, show: Callable[[bytes], None]) -> Ending:
    try:
        executor.start(work)
    except CannotStart as error:
        return error.ending
    over = threading.Event()
    shown = threading.Thread(target=_follow, args=(work.folder / "log", over, show))
    shown.start()
    try:
        while True:
            ending = executor.wait(work, timeout_s=1.0)
            if ending is not None:
                return ending
    except KeyboardInterrupt:
        executor.stop(work)
        return executor.wait(work, timeout_s=60) or Ending(EndReason.lost, "It could not be ended.")
    finally:
        over.set()
        shown.join()
        executor.remove(work)


def _follow(log: Path, over: threading.Event, show: Callable[[bytes], None]) -> None:
    """Show what is written to a file until it is over, and what was written by then."""
    while not log.exists():
        if over.wait(_LOOK_EVERY_S):
            break
    if not log.exists():
        return
    with log.open("rb") as stream:
        while True:
            is_over = over.is_set()
            while data := stream.read(65536):
                show(data)
            if is_over:
                return
            over.wait(_LOOK_EVERY_S)


@contextmanager
def _folder() -> Iterator[Path]:
    """A folder for one run, which is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="klein-run-") as made:
        folder = Path(made)
        # Some executors run it as somebody else.
        folder.chmod(0o711)
        (folder / "in").mkdir()
        yield folder
