"""`python -m kleinkram.runner.kubernetes_pod fetch|store|probe`: what the pods of Kleinkram do.

They speak the protocol of runners for one run, with the code of runners. They run no code of strangers, and share no
pod with it; the files that they read from the volume are untrusted, as on any machine.
"""

import argparse
import contextlib
import gzip
import json
import logging
import shutil
import socket
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from kleinkram.client._http import Api
from kleinkram.client.config import Endpoint, EndpointSource
from kleinkram.client.runs import Runners
from kleinkram.client.server import Service
from kleinkram.client.transfer.store import StoreClient
from kleinkram.contract.errors import RunGone
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart, Ending
from kleinkram.runner.executors.kubernetes.manifests import ASSIGNMENT_FILE, PodAssignment
from kleinkram.runner.executors.kubernetes.transfer_output import FetchOutcome, finish_lines
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.supervision import JobLimits, LimitMonitor
from kleinkram.runner.input_cache import InputCache, InputFile, InputSource, place_inputs
from kleinkram.runner.inputs import InputDownload, place_run_inputs
from kleinkram.runner.logs import Redactor
from kleinkram.runner.result_upload import JobOutput, ResultUpload
from kleinkram.runner.run_requests import RunRequests
from kleinkram.runner.state_directory import RunnerContext, StopSignal, remove_tree

_TERMINATION_LOG = Path("/dev/termination-log")
_CONNECTIONS = 8
_CONNECT_S = 5.0
_CACHE = "cache"


class VolumeExecutor(ProcessExecutor):
    """Places inputs on the volume of a run. It runs nothing."""

    def __init__(self, volume: Path) -> None:
        super().__init__()
        self._volume = volume

    def place_inputs(self, directory: Path, files: Mapping[str, InputFile], source: InputSource) -> None:
        """Download the inputs beside `directory`, continuing an earlier pod's download, and link them."""
        place_inputs(InputCache(self._volume / _CACHE, sys.maxsize), directory, files, source, copy=False)


def fetch(assigned: PodAssignment, volume: Path) -> FetchOutcome:
    """Write the inputs of a run to its volume."""
    with _context(assigned, VolumeExecutor(volume)) as context:
        source = InputDownload(
            context.runners, context.store, assigned.assignment, StopSignal(), lambda message, fraction: None
        )
        try:
            place_run_inputs(context, source, volume / "in")
        except CannotStart as error:
            return FetchOutcome(ending=error.ending)
        except RunGone:
            return FetchOutcome(is_gone=True)
    shutil.rmtree(volume / _CACHE, ignore_errors=True)
    remove_tree(volume / "out")
    (volume / "out").mkdir()
    return FetchOutcome()


def store(assigned: PodAssignment, volume: Path, ending: Ending) -> None:
    """Upload the results of a run from its volume, and write what to report to stdout."""
    resources = assigned.assignment.resources
    limits = LimitMonitor(volume, JobLimits(resources.memory_bytes, resources.disk_bytes, resources.time_s, 0))
    limits.check_disk()
    if ending.reason is EndReason.done and limits.reason is not None:
        # Volumes of some clusters have no limit.
        ending = Ending.of(limits.reason, ending.exit_code)
    output = JobOutput(volume, lambda: volume / "out", lambda offset, size_bytes: b"")
    with _context(assigned, VolumeExecutor(volume)) as context:
        upload = ResultUpload(
            context.runners,
            context.url,
            output,
            assigned.assignment,
            stop=StopSignal(),
            redactor=Redactor([assigned.token]),
            progress=None,
        )
        finish = upload.upload(ending)
    sys.stdout.buffer.write(b"".join(line + b"\n" for line in finish_lines(finish)))
    sys.stdout.flush()


def probe(targets: Sequence[str]) -> list[bool]:
    """Return which addresses, each a host and a port, can be connected to."""
    return [_is_reachable(*target.split()) for target in targets]


def _is_reachable(host: str, port: str) -> bool:
    try:
        socket.create_connection((host, int(port)), _CONNECT_S).close()
    except OSError:
        return False
    return True


@contextlib.contextmanager
def _context(assigned: PodAssignment, executor: VolumeExecutor) -> Iterator[RunnerContext]:
    api = Api(Endpoint("runner", assigned.url, assigned.token, EndpointSource.argument))
    runners, storage = Runners(api), StoreClient(_CONNECTIONS)
    try:
        yield RunnerContext(
            executor=executor,
            runners=runners,
            requests=RunRequests(runners),
            store=storage,
            url=assigned.url,
            token=assigned.token,
            token_file=None,
            service=Service(api),
            default_image=None,
            on_change=lambda: None,
        )
    finally:
        api.close()
        storage.close()


def main() -> None:
    """Do what the arguments say; the outcome of `fetch` and `probe` is the termination message."""
    parser = argparse.ArgumentParser()
    parser.add_argument("step", choices=("fetch", "store", "probe"))
    parser.add_argument("targets", nargs="*")
    parser.add_argument("--volume", type=Path)
    parser.add_argument("--assignment", type=Path)
    parser.add_argument("--ending")
    parser.add_argument("--outcome", type=Path, default=_TERMINATION_LOG)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr)
    # It would log URLs, which are signed.
    logging.getLogger("urllib3").setLevel(logging.ERROR)
    if arguments.step == "probe":
        arguments.outcome.write_text(json.dumps(probe(arguments.targets)))
        return
    assigned = PodAssignment.model_validate_json(gzip.decompress((arguments.assignment / ASSIGNMENT_FILE).read_bytes()))
    if arguments.step == "fetch":
        arguments.outcome.write_text(fetch(assigned, arguments.volume).text())
        return
    reason, message, exit_code = json.loads(arguments.ending)
    store(assigned, arguments.volume, Ending(EndReason(reason), message, exit_code))


if __name__ == "__main__":
    main()
