"""`python -m kleinkram.runner.node_transfers fetch|upload DIRECTORY [START]`: the transfers of one job, on its node.

`fetch` downloads the inputs that the shared cache lacks and links all of them into `DIRECTORY/in`; the URLs are signed
now, however long the job waited. `upload` uploads log and artifacts, and leaves in `finish.json` what the runner is to
report. The server refuses both for an attempt that is outdated. Both may be repeated, and killed at any moment: what
`upload` does not complete, the runner does, since the directory is on a file system that both see.

The runner itself uses the functions below: it orders the transfers, and reads what came of them.
"""

import json
import os
import signal
import socket
import sys
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client._http import Api
from kleinkram.client.config import Endpoint, EndpointSource
from kleinkram.client.runs import Runners
from kleinkram.client.transfer.store import StoreClient
from kleinkram.contract.errors import Forbidden, KleinkramError, NotAuthenticated, RunGone, ScopeMissing
from kleinkram.contract.runs import EndReason
from kleinkram.runner.arguments import find_token
from kleinkram.runner.executors import linux_syscalls
from kleinkram.runner.executors.base import CannotStart, Ending
from kleinkram.runner.executors.supervision import ending_file, read_log_of, write_atomically
from kleinkram.runner.executors.transfer_steps import ORDER, STATUS, finish_file
from kleinkram.runner.input_cache import InputCache, place_inputs
from kleinkram.runner.inputs import InputDownload, fetch_inputs, input_files, make_readable, repeat_while_unavailable
from kleinkram.runner.logs import Redactor
from kleinkram.runner.result_upload import JobOutput, ResultUpload
from kleinkram.runner.results import ProgressReader
from kleinkram.runner.state_directory import Attempt, StopRequest, StopRequested, StopSignal, read_attempt

_STORE_CONNECTIONS = 8
_REFUSALS = (NotAuthenticated, Forbidden, ScopeMissing)
_UNAVAILABLE_S = 300.0


class TransferOrder(BaseModel):
    """What a node needs to know beside the state of the attempt. `copy_inputs`: no links, as the job could change them.

    `authorities` is the file of certificates that the runner trusts, if it has its own.
    """

    model_config = ConfigDict(frozen=True)

    url: str
    token_file: Path
    authorities: Path | None
    cache: Path
    cache_bytes: int
    copy_inputs: bool


class TransferStatus(BaseModel):
    """What the download of inputs does. Once it is over, how many bytes came from the store, and from the cache."""

    model_config = ConfigDict(frozen=True)

    message: str
    is_over: bool = False
    store_bytes: int = 0
    cache_bytes: int = 0


def order_transfers(directory: Path, url: str, token_file: Path, cache: InputCache, *, copy_inputs: bool) -> None:
    """Have the node of a job move its files."""
    authorities = os.environ.get("SSL_CERT_FILE")
    order = TransferOrder(
        url=url,
        token_file=token_file,
        authorities=Path(authorities) if authorities else None,
        cache=cache.directory,
        cache_bytes=cache.limit_bytes,
        copy_inputs=copy_inputs,
    )
    write_status(directory, TransferStatus(message="waits for its node"))
    write_atomically(directory / ORDER, order.model_dump_json())


def read_status(directory: Path) -> TransferStatus | None:
    """Return what the download of the inputs of a job does; None where its node moves no files.

    Raises:
        OSError: the folder cannot be read at the moment.
    """
    try:
        return TransferStatus.model_validate_json((directory / STATUS).read_bytes())
    except (FileNotFoundError, ValidationError):
        return None


def write_status(directory: Path, status: TransferStatus) -> None:
    """Write it, for the runner to read."""
    write_atomically(directory / STATUS, status.model_dump_json())


class NodeTransfers:
    """The transfers of one attempt, on this node."""

    def __init__(self, attempt: Attempt, stop: StopSignal) -> None:
        self._attempt = attempt
        self._directory = attempt.directory
        self._assignment = attempt.state.assignment
        self._stop = stop
        self._order = TransferOrder.model_validate_json((self._directory / ORDER).read_bytes())
        if self._order.authorities is not None:
            os.environ["SSL_CERT_FILE"] = str(self._order.authorities)
        self._token = find_token(self._order.token_file)
        self._runners = Runners(Api(Endpoint("runner", self._order.url, self._token, EndpointSource.argument)))
        self._shown = ""

    def fetch(self) -> None:
        """Place the inputs.

        Raises:
            CannotStart: one is not available here.
        """
        order, target = self._order, self._directory / "in"
        cache = InputCache(order.cache, order.cache_bytes)
        store = StoreClient(_STORE_CONNECTIONS)
        source = InputDownload(self._runners, store, self._assignment, self._stop, self._show)
        files = input_files(self._assignment)

        def place() -> None:
            try:
                fetch_inputs(lambda: place_inputs(cache, target, files, source, copy=order.copy_inputs))
            except _REFUSALS as error:
                file = self._order.token_file
                message = f"The server does not accept the token of its runner any more. Replace it in {file}."
                raise CannotStart(Ending(EndReason.inputs_unavailable, message)) from error

        repeat_while_unavailable(place, self._stop.wait)
        make_readable(target)
        placed_bytes = sum(file.size_bytes for file in {*files.values()})
        status = TransferStatus(
            message=self._shown,
            is_over=True,
            store_bytes=source.fetched_bytes,
            cache_bytes=placed_bytes - source.fetched_bytes,
        )
        write_status(self._directory, status)

    def upload(self, start: str = "") -> None:
        """Upload the results of the job, whose ending is recorded; `start` is the token of its start, if it has one."""
        values = json.loads(ending_file(self._directory, start).read_text())
        ending = Ending(EndReason(values["reason"]), values["message"], values["exit_code"])
        progress = ProgressReader(self._directory / "out")
        progress.read()
        upload = ResultUpload(
            self._runners,
            self._order.url,
            JobOutput(
                self._directory,
                lambda: self._directory / "out",
                lambda offset, size_bytes: read_log_of(self._directory, offset, size_bytes),
            ),
            self._assignment,
            stop=self._stop,
            redactor=Redactor([token for token in (self._token, self._assignment.token) if token]),
            progress=progress.progress,
            unavailable_s=_UNAVAILABLE_S,
        )
        finish = upload.upload(ending)
        if finish.reason is EndReason.results_not_stored:
            # The runner tries for days; a node is too precious.
            raise _NotStored(finish.message)
        write_atomically(finish_file(self._directory, start), finish.model_dump_json())

    def _show(self, message: str, _: float) -> None:
        if message != self._shown:
            self._shown = message
            write_status(self._directory, TransferStatus(message=message))


class _NotStored(Exception):
    """Results are not uploaded, or not all of them."""


def _ending_of(error: Exception) -> Ending:
    """Return how a run ends whose inputs cannot be fetched, for a reason that is not one of them."""
    node = socket.gethostname()
    if isinstance(error, RunGone):
        return Ending(EndReason.lost, "Another runner has the run.")
    if isinstance(error, StopRequested):
        return Ending(EndReason.lost, "The download of its inputs was stopped.")
    return Ending(EndReason.inputs_unavailable, f"Its node {node} cannot download its inputs: {error}")


def main() -> None:
    """Make a step. Why inputs cannot be fetched is a line of JSON on stdout; the exit code is 0 after success."""
    step, directory = sys.argv[1], Path(sys.argv[2])
    linux_syscalls.die_with_parent(signal.SIGKILL)
    stop = StopSignal()
    signal.signal(signal.SIGTERM, lambda *_: stop.send(StopRequest.detach))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    try:
        transfers = NodeTransfers(read_attempt(directory), stop)
        if step == "fetch":
            transfers.fetch()
        else:
            transfers.upload(*sys.argv[3:4])
        code = 0
    except (CannotStart, StopRequested, KleinkramError, OSError, _NotStored) as error:
        ending = error.ending if isinstance(error, CannotStart) else _ending_of(error)
        sys.stdout.write(json.dumps({"reason": ending.reason.value, "message": ending.message}) + "\n")
        sys.stdout.flush()
        code = 1
    # Without waiting for threads, which may wait for the store.
    os._exit(code)


if __name__ == "__main__":
    main()
