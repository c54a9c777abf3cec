"""Prepares a run: its image, its inputs, `/in/mission.json`, and the packages of its script."""

import os
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import NamedTuple, TypeVar
from urllib.parse import urlsplit

import urllib3

from kleinkram.client._http import Backoff
from kleinkram.client.runs import Runners
from kleinkram.client.transfer.store import TRANSFER_RETRY_S, StoreAnswer, StoreClient
from kleinkram.contract.actions import ActionDefinition, Network
from kleinkram.contract.errors import FileUnavailable, InvalidRequest, KleinkramError, NotFound, RunGone
from kleinkram.contract.names import check_file_path
from kleinkram.contract.runners import InputsRequest, RunAssignment
from kleinkram.contract.runs import CONTEXT_FILE, EndReason, RunContext
from kleinkram.environments.cache import Environment, Show
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors.base import CannotStart, Ending, Executor, LockedScript, PinnedImage, RunJob
from kleinkram.runner.executors.port_forward import PortForward
from kleinkram.runner.input_cache import InputCache, InputDamaged, InputFile, NoSpace, PartialInput, Place
from kleinkram.runner.state_directory import Attempt, RunnerContext, StopSignal, remove_tree

_OWN_DIRECTORY = ".kleinkram"
_SCRIPT = f"{_OWN_DIRECTORY}/script.py"
# Certificates that the runner trusts, for a job that may reach the server.
_AUTHORITIES = f"{_OWN_DIRECTORY}/authorities.pem"
_RESERVED_NAMES = {CONTEXT_FILE, _OWN_DIRECTORY}
_DEFAULT_PORTS = {"http": 80, "https": 443}
_DOWNLOADS = 4
_URLS_PER_REQUEST = 500
_SLICE_BYTES = 256 * 2**10
_CHECK_EVERY_S = 0.1
_IMAGE_CHECK_EVERY_S = 0.02
_MAX_REFUSALS = 4
_DOWNLOADING = "downloading inputs"
_MAX_SHOWN = 200
# A server that is unavailable comes back.
_RETRY_S = 600.0
_T = TypeVar("_T")
_PERMANENT_ERRORS = (NotFound, FileUnavailable, InvalidRequest)


class PreparedRun(NamedTuple):
    """What a prepared run starts with.

    Its image, the URL of the store if the run may connect to it, and the packages of its script.
    """

    image: PinnedImage | None
    store_url: str
    environment: Environment | None


def prepare_run(
    context: RunnerContext, assignment: RunAssignment, stop: StopSignal, directory: Path, show: Show
) -> PreparedRun:
    """Pull the image while the inputs are placed in `directory`, which becomes `/in`; then install the packages.

    May be repeated. `show` gets the progress of what takes long.

    Raises:
        CannotStart: something is not available here.
        StopRequested: the run is to stop.
        RunGone: it is not this runner's.
    """
    image = _image_of(context, assignment)
    pulled = _pull_in_thread(context.executor, image) if image else None
    source = InputDownload(context.runners, context.store, assignment, stop, show)
    store_url = place_run_inputs(context, source, directory)
    while pulled and not pulled.done():
        stop.wait(_IMAGE_CHECK_EVERY_S)
    pinned = pulled.result() if pulled else None
    environment = None
    if assignment.lock is not None:
        script = LockedScript(assignment.lock, assignment.requires_python, pinned.reference if pinned else None)
        environment = context.executor.place_environment(script, wait=stop.wait, show=show)
    return PreparedRun(pinned, store_url, environment)


def place_run_inputs(context: RunnerContext, source: "InputDownload", directory: Path) -> str:
    """Place the inputs of a run and what else it sees in `/in`; return the URL of the store if it may connect to it.

    May be repeated. Where compute nodes download inputs, they are left to them.

    Raises:
        CannotStart: something is not available.
        StopRequested: the run is to stop.
        RunGone: it is not this runner's.
    """
    assignment = source.assignment

    def place_files() -> None:
        remove_tree(directory)
        directory.mkdir()
        files = input_files(assignment)
        if context.executor.node_cache is None:
            fetch_inputs(lambda: context.executor.place_inputs(directory, files, source))
            placed_bytes = sum(file.size_bytes for file in {*files.values()})
            context.statistics.count_inputs("store", source.fetched_bytes)
            context.statistics.count_inputs("cache", placed_bytes - source.fetched_bytes)

    def place_context() -> str:
        run_context = context.requests.get_context(assignment.run_id, assignment.attempt)
        trusted = os.environ.get("SSL_CERT_FILE") if assignment.network is Network.api else None
        write_context(directory, run_context, assignment.script, Path(trusted).read_text() if trusted else None)
        return context.service.get().store_url if assignment.network is Network.api else ""

    repeat_while_unavailable(place_files, source.wait)
    # By itself: inputs that are placed stay.
    store_url = repeat_while_unavailable(place_context, source.wait)
    make_readable(directory)
    return store_url


def input_files(assignment: RunAssignment) -> dict[str, InputFile]:
    """Return the inputs of a run by their paths below `/in`.

    Raises:
        CannotStart: one cannot be there.
    """
    files: dict[str, InputFile] = {}
    for file in assignment.inputs:
        try:
            files[check_input_path(file.path)] = InputFile(file.sha256, file.size_bytes)
        except ValueError as error:  # noqa: PERF203  each error names its file
            raise _unavailable(f"The file {file.path} {error}.") from error
    return files


def fetch_inputs(place: Callable[[], None]) -> None:
    """Place inputs.

    Raises:
        CannotStart: one is not available, or the disk is full.
    """
    try:
        place()
    except NoSpace as error:
        raise _unavailable(str(error)) from error
    except OSError as error:
        raise _unavailable(f"Its inputs cannot be placed: {error.strerror}.") from error


def repeat_while_unavailable(step: Callable[[], _T], wait_for: Wait) -> _T:
    """Return what a step of the preparation returns, repeated for some minutes while the server is unavailable.

    Raises:
        CannotStart: it is unavailable for longer, or refuses.
        StopRequested: the run is to stop.
        RunGone: it is not this runner's.
    """
    backoff = Backoff(_RETRY_S, wait_for)
    while True:
        try:
            return step()
        except RunGone:  # noqa: PERF203  each round takes seconds
            raise
        except KleinkramError as error:
            if isinstance(error, _PERMANENT_ERRORS) or not backoff.pause():
                raise _unavailable(str(error)) from error


def make_readable(directory: Path) -> None:
    """Make everything in a directory readable for each user, and its files read-only."""
    for path in [directory, *directory.rglob("*")]:
        if path.is_dir():
            path.chmod(0o755)
        elif path.stat().st_mode & 0o777 != 0o444:
            path.chmod(0o444)


def _image_of(context: RunnerContext, assignment: RunAssignment) -> str | None:
    """Return the image to run, if any. Raises CannotStart where this runner cannot do what the run needs."""
    abilities = context.executor.abilities
    lacks = None
    if assignment.network not in abilities.networks:
        lacks = f"does not offer the network {assignment.network.value!r}"
    elif assignment.image is not None and not abilities.images:
        lacks = "runs no images, only scripts"
    elif assignment.resources.gpus and not abilities.gpus:
        lacks = "has no GPU for runs"
    elif assignment.lock is not None and not abilities.environments:
        lacks = "installs no packages for scripts"
    elif assignment.image is None and abilities.images and context.default_image is None:
        lacks = "has no default image to run scripts on"
    if lacks is not None:
        raise CannotStart(Ending(EndReason.not_possible, f"Its runner {lacks}."))
    if assignment.image is None:
        return context.default_image if abilities.images else None
    is_pinned = assignment.image_digest is None or "@" in assignment.image
    return assignment.image if is_pinned else f"{assignment.image}@{assignment.image_digest}"


def _pull_in_thread(executor: Executor, image: str) -> Future[PinnedImage]:
    """Pull an image in a thread, which a cancelled run does not wait for."""
    pulled: Future[PinnedImage] = Future()

    def pull() -> None:
        try:
            pulled.set_result(executor.prepare_image(image))
        except CannotStart as error:
            pulled.set_exception(error)
        except BaseException:
            ending = Ending(EndReason.image_unavailable, f"The image {image} could not be pulled.")
            pulled.set_exception(CannotStart(ending))
            raise

    threading.Thread(target=pull, name="image", daemon=True).start()
    return pulled


class InputDownload:
    """Downloads the inputs of one run by signed URLs, and resumes broken downloads."""

    def __init__(
        self, runners: Runners, store: StoreClient, assignment: RunAssignment, stop: StopSignal, show: Show
    ) -> None:
        self._runners = runners.with_retry(TRANSFER_RETRY_S, stop.wait)
        self._store = store
        self.assignment = assignment
        self.wait = stop.wait
        self.show = show
        self._stop = stop
        self._urls: dict[str, str] = {}
        self.fetched_bytes = 0
        self._lock = threading.Lock()

    def fetch_into(self, cache: InputCache, missing: Sequence[InputFile], place: Place) -> None:
        """Download files to a cache, and `place` each; one that was evicted before is downloaded again.

        Raises:
            CannotStart: one is not available, or the disk is full.
            StopRequested: the run is to stop.
            RunGone: it is not this runner's.
        """
        paths = {file.sha256: file.path for file in self.assignment.inputs}
        is_over = threading.Event()
        pool = ThreadPoolExecutor(min(_DOWNLOADS, len(missing)), "download")
        try:
            for first in range(0, len(missing), _URLS_PER_REQUEST):
                batch = missing[first : first + _URLS_PER_REQUEST]
                self._sign([paths[file.sha256] for file in batch])
                waiting = [*batch]
                downloads: dict[Future[None], InputFile] = {}
                while waiting or downloads:
                    for file in waiting:
                        downloads[pool.submit(self._fetch, cache, file, paths[file.sha256], is_over)] = file
                    done, _ = wait(downloads, timeout=_CHECK_EVERY_S, return_when=FIRST_COMPLETED)
                    for download in done:
                        download.result()
                    waiting = [file for file in map(downloads.pop, done) if not place(file)]
                    self._stop.check()
        finally:
            # A thread that waits for the store notices this later.
            is_over.set()
            pool.shutdown(wait=False, cancel_futures=True)

    def _fetch(self, cache: InputCache, file: InputFile, path: str, is_over: threading.Event) -> None:
        def check() -> None:
            self._stop.check()
            if is_over.is_set():
                raise _unavailable("Another input is not available.")

        def wait_for_other(seconds: float) -> None:
            self.show(f"waits for the download of another job: {Path(path).name}"[:_MAX_SHOWN], 0)
            check()
            self._stop.wait(seconds)

        try:
            cache.get(file, lambda part: self._receive(part, path, check), wait_for_other)
        except InputDamaged as error:
            raise _unavailable(f"The input {path} is damaged: {error}.") from error

    def _sign(self, paths: Sequence[str]) -> None:
        request = InputsRequest(attempt=self.assignment.attempt, paths=[*paths])
        urls = self._runners.sign_inputs(self.assignment.run_id, request).urls
        with self._lock:
            self._urls.update(zip(paths, urls, strict=True))

    def _receive(self, part: PartialInput, path: str, check: Callable[[], None]) -> None:
        """Receive the missing bytes of a file, from where the last connection broke."""
        backoff, refusals = Backoff(TRANSFER_RETRY_S, self._stop.wait), 0
        self.show(_DOWNLOADING, 0)
        while part.offset < part.file.size_bytes:
            check()
            before = part.offset
            answer = self._store.get(self._urls[path], before, part.file.size_bytes - 1, _SLICE_BYTES)
            try:
                for data in answer.slices():
                    part.add(data)
                    check()
            except urllib3.exceptions.HTTPError as error:
                answer.error = error
            finally:
                answer.close()
                with self._lock:
                    self.fetched_bytes += part.offset - before
            if part.offset > before:
                backoff = Backoff(TRANSFER_RETRY_S, self._stop.wait)
            elif answer.answer is StoreAnswer.sign_again and refusals < _MAX_REFUSALS:
                refusals += 1
                self._sign([path])
            elif answer.answer in {StoreAnswer.taken, StoreAnswer.try_again}:
                if not backoff.pause():
                    raise _unavailable(f"The input {path} cannot be downloaded: {answer.why}.")
            else:
                raise _unavailable(f"The input {path} cannot be downloaded: {answer.reason}.")


def _unavailable(message: str) -> CannotStart:
    return CannotStart(Ending(EndReason.inputs_unavailable, message))


def check_input_path(path: str) -> str:
    """Return the path of a file of a mission below `/in`.

    Raises:
        ValueError: it leaves the directory, or is reserved for the runner.
    """
    path = check_file_path(path)
    if path.partition("/")[0] in _RESERVED_NAMES:
        raise ValueError("has a name that runners use in /in; rename it")
    return path


def write_context(directory: Path, context: RunContext, script: str | None, authorities: str | None = None) -> None:
    """Write `mission.json`, the script and certificates (PEM) to the directory that becomes `/in`."""
    (directory / CONTEXT_FILE).write_text(context.model_dump_json(indent=1))
    for name, text in ((_SCRIPT, script), (_AUTHORITIES, authorities)):
        if text is not None:
            path = directory / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)


def command_of(action: ActionDefinition | RunAssignment, *, in_image: bool) -> list[str]:
    """Return the command of an action; of a script, with the Python of the image, or else this one."""
    if action.script is None:
        return list(action.command)
    python = "python3" if in_image else sys.executable
    return [python, "-m", "kleinkram.action.launch", _SCRIPT, *action.dependencies]


def job_of(context: RunnerContext, attempt: Attempt) -> RunJob:
    """Return the job of an attempt, which is the same after a restart of the runner."""
    assignment, image = attempt.state.assignment, attempt.state.image
    environment = {
        "KLEINKRAM_URL": context.url,
        "KLEINKRAM_TOKEN": assignment.token or "",
        "KLEINKRAM_PROJECT_ID": str(assignment.project_id),
        "KLEINKRAM_MISSION_ID": str(assignment.mission_id),
        "KLEINKRAM_RUN_ID": str(assignment.run_id),
    }
    if (attempt.directory / "in" / _AUTHORITIES).is_file():
        environment["SSL_CERT_FILE"] = f"/in/{_AUTHORITIES}"
    forwards: dict[PortForward, None] = {}
    for url in (context.url, attempt.state.store_url) if assignment.network is Network.api else ():
        if url:
            parts = urlsplit(url)
            host, port = parts.hostname or "", parts.port or _DEFAULT_PORTS[parts.scheme]
            forwards[PortForward(host, port, host, port)] = None
    return RunJob(
        key=attempt.key,
        directory=attempt.directory,
        command=command_of(assignment, in_image=image is not None),
        image=image,
        packages=attempt.state.packages,
        resources=assignment.resources,
        cluster=assignment.cluster,
        network=assignment.network,
        environment=environment if assignment.token else {},
        port_forwards=tuple(forwards),
    )
