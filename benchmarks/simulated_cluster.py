"""A runner whose jobs are simulated: it speaks the protocol as the runner of a login node does, and executes nothing.

Its jobs wait in a queue and run for as long as those of a cluster could; then they leave a log,
and perhaps a small file.
"""

import hashlib
import heapq
import itertools
import random
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from kleinkram.client._http import Api
from kleinkram.client.config import Endpoint, EndpointSource
from kleinkram.client.files import Uploads
from kleinkram.client.runs import Runners
from kleinkram.client.transfer.store import StoreClient
from kleinkram.contract.actions import Network
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runners import (
    HEARTBEAT_S,
    MAX_CLAIMED,
    MAX_RUNS,
    Capacity,
    ClaimRequest,
    ExecutorAbilities,
    Heartbeat,
    InputsRequest,
    RunAssignment,
    RunAttempt,
    RunEnd,
    RunFinish,
    RunnerRegistration,
)
from kleinkram.contract.runs import EndReason, RunPlacement, RunState
from kleinkram.contract.uploads import PartToSign, UploadFile, UploadFinish, UploadRequired, crc64nvme
from kleinkram.runner.run_requests import HeartbeatRequests, report_pause_s

# How long the cluster takes to start a job, and to run it, in seconds.
_PENDING_S, _RUNNING_S = (0.5, 5.0), (10.0, 30.0)
_THREADS = 16
# As that of a login node.
_LEASE_S = 900
_ROOM = Capacity(cores=64, memory_bytes=2**40, disk_bytes=2**42, gpus=0)
_ABILITIES = ExecutorAbilities(
    executor="slurm",
    isolation=Isolation.container,
    images=True,
    networks=frozenset({Network.none}),
    gpus=False,
    bounds_memory=True,
    bounds_disk=True,
)
_LOG, _ARTIFACT = b"reading\nwriting\n" * 100, b"metric,value\nate_rmse,0.12\n" * 50


@dataclass
class _Job:
    assignment: RunAssignment
    number: int
    state: RunState = RunState.preparing

    def heartbeat(self) -> Heartbeat:
        placement = RunPlacement(job_id=f"4711_{self.number}", node="node7") if self.state is RunState.running else None
        attempt = self.assignment.attempt
        return Heartbeat(run_id=self.assignment.run_id, attempt=attempt, state=self.state, placement=placement)


class SimulatedCluster:
    """Executes runs, so many at once; `requests` counts those to the API."""

    def __init__(self, url: str, token: str, *, at_once: int) -> None:
        self._api = Api(Endpoint("cluster", url, token, EndpointSource.argument))
        self._runners, self._store = Runners(self._api), StoreClient(_THREADS)
        self._at_once = at_once
        self._id = uuid.uuid4()
        self._active: dict[uuid.UUID, _Job] = {}
        self._lock = threading.Lock()
        self._heartbeats = HeartbeatRequests()
        self._due: list[tuple[float, int, Callable[[_Job], None], _Job]] = []
        self._order = itertools.count()
        self._random = random.Random(28)
        self._ended: list[_Job] = []
        self._has_inputs = self._with_files = False
        self._is_over = threading.Event()
        self._errors: list[BaseException] = []
        self.requests = 0

    def register(self) -> None:
        """Make the runner known."""
        self._runners.register(
            RunnerRegistration(
                id=self._id,
                name="cluster",
                labels=["cluster"],
                capacity=_ROOM,
                abilities=_ABILITIES,
                lease_s=_LEASE_S,
                default_image=f"sha256:{'0' * 64}",
                version="0",
            )
        )

    def run(self, runs: int, *, with_files: bool = False) -> None:
        """Claim so many runs, and take them to their ends; `with_files`, each leaves a small file."""
        self._with_files = with_files
        self._is_over.clear()
        heartbeats = threading.Thread(target=self._send_heartbeats)
        heartbeats.start()
        claimed, report_at_s = 0, 0.0
        try:
            with ThreadPoolExecutor(_THREADS) as pool:
                while (claimed < runs or self._active) and not self._errors:
                    if claimed < runs and len(self._active) < self._at_once:
                        claimed += self._claim(min(self._at_once - len(self._active), runs - claimed))
                    self._go_on(pool)
                    if time.monotonic() >= report_at_s:
                        self._report_ends()
                        report_at_s = time.monotonic() + report_pause_s(len(self._active))
                    time.sleep(0.02)
        finally:
            self._is_over.set()
            heartbeats.join()
        if self._errors:
            raise self._errors[0]

    def _claim(self, count: int) -> int:
        request = ClaimRequest(free=_ROOM, max_runs=min(count, MAX_CLAIMED), active_run_ids=[*self._active])
        self._count()
        jobs = [_Job(assignment, next(self._order)) for assignment in self._runners.claim(self._id, request)]
        with self._lock:
            self._active |= {job.assignment.run_id: job for job in jobs}
        if jobs:
            self._prepare(jobs)
        return len(jobs)

    def _go_on(self, pool: ThreadPoolExecutor) -> None:
        """Have jobs whose time has come do their next step."""
        while True:
            with self._lock:
                if not self._due or self._due[0][0] > time.monotonic():
                    return
                _, _, step, job = heapq.heappop(self._due)
            pool.submit(step, job).add_done_callback(self._note_error)

    def _note_error(self, future: "Future[None]") -> None:
        if (error := future.exception()) is not None:
            self._errors.append(error)

    def _later(self, seconds: float, step: Callable[[_Job], None], job: _Job) -> None:
        with self._lock:
            heapq.heappush(self._due, (time.monotonic() + seconds, next(self._order), step, job))

    def _count(self, requests: int = 1) -> None:
        with self._lock:
            self.requests += requests

    def _prepare(self, jobs: Sequence[_Job]) -> None:
        self._count()
        attempts = [RunAttempt(run_id=job.assignment.run_id, attempt=job.assignment.attempt) for job in jobs]
        self._runners.get_contexts(self._id, attempts)
        if not self._has_inputs:
            # Afterwards all are in the cache that nodes share.
            self._has_inputs = True
            self._count()
            first = jobs[0].assignment
            paths = [entry.path for entry in first.inputs]
            self._runners.sign_inputs(first.run_id, InputsRequest(attempt=first.attempt, paths=paths))
        for job in jobs:
            self._later(self._random.uniform(*_PENDING_S), self._start, job)

    def _start(self, job: _Job) -> None:
        job.state = RunState.running
        self._later(self._random.uniform(*_RUNNING_S), self._collect, job)

    def _collect(self, job: _Job) -> None:
        job.state = RunState.collecting
        if self._with_files:
            uploads = self._runners.uploads(job.assignment.attempt)
            self._upload(job.assignment.run_id, uploads, {"metrics.csv": _ARTIFACT})
            self._count(3)
        with self._lock:
            self._ended.append(job)

    def _report_ends(self) -> None:
        """Report what ended, as a runner with many runs does."""
        with self._lock:
            jobs, self._ended = self._ended[:MAX_RUNS], self._ended[MAX_RUNS:]
        if not jobs:
            return
        ends = [
            RunEnd(
                run_id=job.assignment.run_id,
                finish=RunFinish(
                    attempt=job.assignment.attempt,
                    reason=EndReason.done,
                    message="The command returned 0.",
                    exit_code=0,
                    log=_LOG,
                ),
            )
            for job in jobs
        ]
        self._count()
        if None in self._runners.finish_all(self._id, ends):
            raise SystemExit("the end of a run was not recorded")
        with self._lock:
            for job in jobs:
                del self._active[job.assignment.run_id]

    def _upload(self, run_id: uuid.UUID, uploads: Uploads, files: dict[str, bytes]) -> None:
        announced = [
            UploadFile(path=path, size_bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
            for path, data in files.items()
        ]
        finishes, parts = [], []
        for decision, data in zip(uploads.begin(run_id, announced).items, files.values(), strict=True):
            if not isinstance(decision, UploadRequired):
                raise SystemExit(f"an artifact was refused: {decision}")
            crc64, sha256 = f"{crc64nvme(data):016x}", hashlib.sha256(data).hexdigest()
            finishes.append(UploadFinish(upload_id=decision.upload.id, sha256=sha256, crc64nvme=crc64))
            checksums = {"crc64nvme": crc64, "sha256": sha256}
            checksum = checksums[decision.upload.checksum.value]
            parts.append(PartToSign(upload_id=decision.upload.id, number=1, checksum=checksum))
        for signed, data in zip(uploads.sign(parts).items, files.values(), strict=True):
            self._store.put(signed.url, signed.headers, len(data), [data])
        uploads.complete(finishes)

    def _send_heartbeats(self) -> None:
        while not self._is_over.wait(max(HEARTBEAT_S, report_pause_s(len(self._active)))):
            with self._lock:
                heartbeats = [job.heartbeat() for job in self._active.values()]
            if not heartbeats:
                continue
            for request in self._heartbeats.build(heartbeats):
                self._count()
                self._heartbeats.match(request, self._runners.send_heartbeats(self._id, request))
