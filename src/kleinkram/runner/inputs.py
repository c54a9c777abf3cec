"""Prepares a run: its image, its inputs, and `/in/mission.json`."""

import os
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import NamedTuple

import urllib3

from kleinkram.client._retry import Backoff
from kleinkram.client.runners import Runners
from kleinkram.client.server import Service
from kleinkram.client.transfer.store import PATIENCE_S, StoreAnswer, StoreClient
from kleinkram.contract.actions import Network
from kleinkram.contract.errors import FileUnavailable, InvalidRequest, KleinkramError, NotFound, RunGone
from kleinkram.contract.names import check_file_path
from kleinkram.contract.runners import AssignedInput, InputsRequest, RunAssignment
from kleinkram.contract.runs import CONTEXT_FILE, EndReason, RunContext
from kleinkram.runner.cancellation import StopSignal
from kleinkram.runner.executors.base import CannotStart, Ending, Executor, PinnedImage
from kleinkram.runner.files import remove_tree
from kleinkram.runner.input_cache import InputCache, InputDamaged, InputFile, NoSpace, PartialInput

_OWN_DIRECTORY = ".kleinkram"
_SCRIPT = f"{_OWN_DIRECTORY}/script.py"
# Certificates that the runner trusts, for a job that may reach the server.
AUTHORITIES = f"{_OWN_DIRECTORY}/authorities.pem"
_RESERVED_NAMES = {CONTEXT_FILE, _OWN_DIRECTORY}
_DOWNLOADS = 4
_URLS_PER_REQUEST = 500
_SLICE_BYTES = 256 * 2**10
_CHECK_EVERY_S = 0.1
_IMAGE_CHECK_EVERY_S = 0.02
_MAX_REFUSALS = 4
# A server that is unavailable comes back.
_RETRY_S = 600.0
_PERMANENT_ERRORS = (NotFound, FileUnavailable, InvalidRequest)


class Prepared(NamedTuple):
    """What a run starts with: its image, and the URL of the store if it may reach that."""

    image: PinnedImage | None
    store_url: str


class Preparation:
    """Prepares one run. May be repeated from the start."""

    def __init__(
        self,
        executor: Executor,
        runners: Runners,
        store: StoreClient,
        service: Service,
        *,
        default_image: str | None,
        assignment: RunAssignment,
        stop: StopSignal,
    ) -> None:
        self._executor = executor
        self._runners = runners
        self._service = service
        self._default_image = default_image
        self._assignment = assignment
        self._stop = stop
        self._source = InputDownload(runners, store, assignment, stop)

    def prepare(self, directory: Path) -> Prepared:
        """Pull the image while the inputs are placed in `directory`, which becomes `/in`.

        Raises:
            CannotStart: something is not available here.
            StopRequested: the run is to stop.
            RunGone: it is not this runner's.
        """
        image = self._image()
        pull = _ImagePull(self._executor, image) if image else None
        store_url = None
        backoff = Backoff(_RETRY_S, self._stop.wait)
        while store_url is None:
            store_url = self._try_to_place(directory, backoff)
        for path in [directory, *directory.rglob("*")]:
            if path.is_dir():
                path.chmod(0o755)
            elif path.stat().st_mode & 0o777 != 0o444:
                path.chmod(0o444)
        return Prepared(pull.result(self._stop) if pull else None, store_url)

    def _try_to_place(self, directory: Path, backoff: Backoff) -> str | None:
        """Place the inputs and return the URL of the store; None where this is to be repeated."""
        try:
            self._place(directory)
            return self._service.get().store_url if self._assignment.network is Network.api else ""
        except RunGone:
            raise
        except KleinkramError as error:
            if isinstance(error, _PERMANENT_ERRORS) or not backoff.pause():
                raise _unavailable(str(error)) from error
            return None

    def _place(self, directory: Path) -> None:
        remove_tree(directory)
        directory.mkdir()
        assignment = self._assignment
        files = {_checked_path(file): InputFile(file.sha256, file.size_bytes) for file in assignment.inputs}
        try:
            self._executor.place_inputs(directory, files, self._source)
        except NoSpace as error:
            raise _unavailable(str(error)) from error
        except OSError as error:
            raise _unavailable(f"Its inputs cannot be placed: {error.strerror}.") from error
        context = self._runners.get_context(assignment.run_id, assignment.attempt)
        write_context(directory, context, assignment.script, self._authorities())

    def _authorities(self) -> str | None:
        trusted = os.environ.get("SSL_CERT_FILE")
        return Path(trusted).read_text() if trusted and self._assignment.network is Network.api else None

    def _image(self) -> str | None:
        """Return the image to run, if any.

        Raises:
            CannotStart: this runner cannot do what the run needs.
        """
        assignment, abilities = self._assignment, self._executor.abilities
        lacks = None
        if assignment.network not in abilities.networks:
            lacks = f"does not offer the network {assignment.network.value!r}"
        elif assignment.image is not None and not abilities.images:
            lacks = "runs no images, only scripts"
        elif assignment.resources.gpus and not abilities.gpus:
            lacks = "has no GPU for runs"
        elif assignment.image is None and abilities.images and self._default_image is None:
            lacks = "has no default image to run scripts on"
        if lacks is not None:
            raise CannotStart(Ending(EndReason.not_possible, f"Its runner {lacks}."))
        if assignment.image is None:
            return self._default_image if abilities.images else None
        is_pinned = assignment.image_digest is None or "@" in assignment.image
        return assignment.image if is_pinned else f"{assignment.image}@{assignment.image_digest}"


class _ImagePull:
    """Pulls an image in a thread: a run that is cancelled does not wait for it."""

    def __init__(self, executor: Executor, image: str) -> None:
        self._executor = executor
        self._image = image
        self._is_over = threading.Event()
        self._pinned: PinnedImage | None = None
        self._failure = Ending(EndReason.image_unavailable, f"The image {image} could not be pulled.")
        threading.Thread(target=self._pull, name="image", daemon=True).start()

    def result(self, stop: StopSignal) -> PinnedImage:
        """Wait for the image.

        Raises:
            CannotStart: it is not available.
            StopRequested: the run is to stop.
        """
        while not self._is_over.wait(_IMAGE_CHECK_EVERY_S):
            stop.check()
        if self._pinned is None:
            raise CannotStart(self._failure)
        return self._pinned

    def _pull(self) -> None:
        try:
            self._pinned = self._executor.prepare_image(self._image)
        except CannotStart as error:
            self._failure = error.ending
        finally:
            self._is_over.set()


class InputDownload:
    """Downloads the inputs of one run by signed URLs, and resumes broken downloads. `store` is shared by all runs."""

    def __init__(self, runners: Runners, store: StoreClient, assignment: RunAssignment, stop: StopSignal) -> None:
        self._runners = runners.with_patience(PATIENCE_S, stop.wait)
        self._store = store
        self._assignment = assignment
        self._stop = stop
        self._urls: dict[str, str] = {}
        self._lock = threading.Lock()

    def fetch_into(self, cache: InputCache, missing: Sequence[InputFile]) -> None:
        """Download files to a cache.

        Raises:
            CannotStart: one is not available, or the disk is full.
            StopRequested: the run is to stop.
            RunGone: it is not this runner's.
        """
        paths = {file.sha256: file.path for file in self._assignment.inputs}
        is_over = threading.Event()
        pool = ThreadPoolExecutor(min(_DOWNLOADS, len(missing)), "download")
        try:
            for first in range(0, len(missing), _URLS_PER_REQUEST):
                batch = missing[first : first + _URLS_PER_REQUEST]
                self._sign([paths[file.sha256] for file in batch])
                self._wait_for({pool.submit(self._fetch, cache, file, paths[file.sha256], is_over) for file in batch})
        finally:
            # A thread that waits for the store notices this later.
            is_over.set()
            pool.shutdown(wait=False, cancel_futures=True)

    def _wait_for(self, downloads: set[Future[None]]) -> None:
        while downloads:
            done, downloads = wait(downloads, timeout=_CHECK_EVERY_S, return_when=FIRST_EXCEPTION)
            for download in done:
                download.result()
            self._stop.check()

    def _fetch(self, cache: InputCache, file: InputFile, path: str, is_over: threading.Event) -> None:
        def check() -> None:
            self._stop.check()
            if is_over.is_set():
                raise _unavailable("Another input is not available.")

        try:
            cache.get(file, lambda part: self._receive(part, path, check), self._stop.wait)
        except InputDamaged as error:
            raise _unavailable(f"The input {path} is damaged: {error}.") from error

    def _sign(self, paths: Sequence[str]) -> None:
        request = InputsRequest(attempt=self._assignment.attempt, paths=[*paths])
        urls = self._runners.sign_inputs(self._assignment.run_id, request).urls
        with self._lock:
            self._urls.update(zip(paths, urls, strict=True))

    def _receive(self, part: PartialInput, path: str, check: Callable[[], None]) -> None:
        """Receive the missing bytes of a file, from where the last connection broke."""
        backoff, refusals = Backoff(PATIENCE_S, self._stop.wait), 0
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
            if part.offset > before:
                backoff = Backoff(PATIENCE_S, self._stop.wait)
            elif answer.answer is StoreAnswer.sign_again and refusals < _MAX_REFUSALS:
                refusals += 1
                self._sign([path])
            elif answer.answer in {StoreAnswer.taken, StoreAnswer.try_again}:
                if not backoff.pause():
                    raise _unavailable(f"The input {path} cannot be downloaded: {answer.why}.")
            else:
                raise _unavailable(f"The input {path} cannot be downloaded: {answer.reason}.")


def _checked_path(file: AssignedInput) -> str:
    try:
        return check_input_path(file.path)
    except ValueError as error:
        raise _unavailable(f"The file {file.path} {error}.") from error


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
    for name, text in ((_SCRIPT, script), (AUTHORITIES, authorities)):
        if text is not None:
            path = directory / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)


def script_command(dependencies: Sequence[str], *, in_image: bool) -> list[str]:
    """Return the command of a script: with the Python of the image, or else this one."""
    python = "python3" if in_image else sys.executable
    return [python, "-m", "kleinkram.action.launch", _SCRIPT, *dependencies]
