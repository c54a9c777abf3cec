"""A fake server and store for runners: in this process, by real HTTP.

It does what tests tell it to, at once: cancels, forgets a runner's run, falls silent, gives wrong bytes.
"""

from __future__ import annotations

import hashlib
import re
import threading
import time
import uuid
from collections import Counter
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel

from kleinkram.contract.errors import InternalError, KleinkramError, NotFound, RunGone, StoreUnavailable
from kleinkram.contract.people import ServiceRead
from kleinkram.contract.runners import (
    LEASE_S,
    LOG_PATH,
    ArtifactUploadsCreate,
    ClaimReply,
    ClaimRequest,
    ContextsRequest,
    Heartbeat,
    HeartbeatReplies,
    HeartbeatReply,
    Heartbeats,
    InputsRequest,
    InputUrls,
    LeaseStatus,
    LogChunkConfirm,
    LogChunkCreate,
    LogChunkUpload,
    RunAssignment,
    RunAttempt,
    RunContexts,
    RunEnds,
    RunEndsRecorded,
    RunFinish,
    RunFinished,
    RunnerRead,
    RunnerRegistration,
)
from kleinkram.contract.runs import Cause, EndReason, RunContext, RunState
from kleinkram.contract.uploads import PartsSign, UploadsComplete
from tests.http_server import Server
from tests.integration.runner_loop.context import LATER, a_mission
from tests.integration.runner_loop.fake_http import Handler
from tests.integration.runner_loop.fake_runs import FakeRun, queued
from tests.integration.runner_loop.fake_uploads import FakeUploads


class FakeServer:
    """The server, at an address of this machine. Its fields may be changed by tests at any time."""

    def __init__(self, address: str = "127.0.0.1") -> None:
        self.runs: dict[uuid.UUID, FakeRun] = {}
        self.registrations: list[RunnerRegistration] = []
        self.requests: Counter[str] = Counter()
        self.requested: list[ClaimRequest] = []
        self.lease_s: float = LEASE_S
        self.is_silent = threading.Event()
        self.spoilt: dict[str, bytes] = {}
        self.slow_bytes_per_s: float | None = None
        self.fails: dict[str, int] = {}
        self.report_refusal: KleinkramError | None = None
        self.holds_uploads = threading.Event()
        self.store_refuses = threading.Event()
        self.store_says = b""
        self.has_no_store = threading.Event()
        self._objects: dict[str, bytes] = {}
        self._changed = threading.Condition()
        self._address = address
        server = self

        class OfThis(Handler):
            fake = server

        self._http = Server((address, 0), OfThis)
        self.uploads = FakeUploads(self.url, self._objects)
        self._thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where API and store answer."""
        return f"http://{self._address}:{self._http.server_port}"

    def close(self) -> None:
        """End it."""
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()

    def launch(self, code: str, inputs: dict[str, bytes] | None = None, **changes: Any) -> FakeRun:
        """Queue a run of a script, unless changes say otherwise."""
        (run,) = self.launch_all([queued(code, inputs or {}, changes)])
        return run

    def launch_all(self, runs: Sequence[FakeRun]) -> Sequence[FakeRun]:
        """Queue runs at the same moment."""
        with self._changed:
            self.runs |= {run.claim.run_id: run for run in runs}
            self._changed.notify_all()
        return runs

    def wake(self) -> None:
        """Wake all long polls for runs."""
        with self._changed:
            self._changed.notify_all()

    def requeue(self, run: FakeRun) -> None:
        """Take a run from its runner, as when its lease ran out."""
        with self._changed:
            run.state, run.runner_id = RunState.queued, None
            self._changed.notify_all()

    # -- what runners say ----------------------------------------------------------------------------------------------

    def answer(self, method: str, path: str, query: str, body: bytes) -> BaseModel | None:
        """Answer a request to the API."""
        name = re.sub(r"[0-9a-f]{8}-[0-9a-f-]{27}", "*", path)
        self.requests[name] += 1
        if self.fails.get(name):
            self.fails[name] -= 1
            raise InternalError(request_id="a-request")
        if self.has_no_store.is_set() and name == "/uploads/complete":
            raise StoreUnavailable(reason="it is away")
        result = re.search(r"[0-9a-f]{8}-[0-9a-f-]{27}", path)
        resource_type = uuid.UUID(result.group()) if result else None
        if name == "/service":
            return self._service()
        if name == "/runners":
            return self._register(RunnerRegistration.model_validate_json(body))
        if name == "/runners/*/claims":
            assert resource_type is not None
            return self._claim(resource_type, ClaimRequest.model_validate_json(body))
        if name == "/runners/*/heartbeats":
            assert resource_type is not None
            return self._heartbeat(resource_type, Heartbeats.model_validate_json(body))
        if name == "/runners/*/contexts":
            return self._contexts(ContextsRequest.model_validate_json(body))
        if name == "/runners/*/ends":
            return self._ends(RunEnds.model_validate_json(body))
        if name == "/uploads/parts":
            return self.uploads.sign(PartsSign.model_validate_json(body))
        if name == "/uploads/complete":
            return self.uploads.complete(UploadsComplete.model_validate_json(body))
        run = self.runs.get(resource_type) if resource_type else None
        if run is None or not name.startswith("/runner/runs/*/"):
            raise NotFound(resource_type="route", ref=path)
        return self._of_run(run, name.removeprefix("/runner/runs/*/"), query, body)

    def _of_run(self, run: FakeRun, what: str, query: str, body: bytes) -> BaseModel | None:
        if what == "context":
            return self._context(run, int(query.removeprefix("attempt=")))
        if what == "inputs":
            requested = InputsRequest.model_validate_json(body)
            self._check(run, requested.attempt)
            urls = [f"{self.url}/store/in/{run.claim.run_id}/{path}?X-Amz-Signature=abc" for path in requested.paths]
            return InputUrls(urls=urls, expires_at=LATER)
        if what == "log-chunks":
            piece = LogChunkCreate.model_validate_json(body)
            self._check(run, piece.attempt)
            key = f"log/{run.claim.run_id}/{piece.attempt}/{piece.offset}"
            return LogChunkUpload(url=f"{self.url}/store/{key}?sha256={piece.sha256}", headers={})
        if what == "log-chunks/confirm":
            self._keep(run, LogChunkConfirm.model_validate_json(body))
            return None
        if what == "uploads":
            begin = ArtifactUploadsCreate.model_validate_json(body)
            while self.holds_uploads.is_set():
                time.sleep(0.02)
            self._check(run, begin.attempt)
            return self.uploads.begin(run, begin)
        return self._finish(run, RunFinish.model_validate_json(body))

    def _context(self, run: FakeRun, attempt: int) -> RunContext:
        self._check(run, attempt)
        return RunContext(
            run_id=run.claim.run_id,
            action=run.claim.action,
            parameters=run.claim.parameters,
            cause=Cause(),
            mission=a_mission(run.claim.mission_id, run.claim.project_id),
            files=[],
            topics=[],
            recordings=[],
        )

    def _contexts(self, requested: ContextsRequest) -> RunContexts:
        contexts: list[RunContext | None] = []
        for one in requested.runs:
            try:
                contexts.append(self._context(self.runs[one.run_id], one.attempt))
            except RunGone:  # noqa: PERF203
                contexts.append(None)
        return RunContexts(contexts=contexts)

    def _ends(self, reported: RunEnds) -> RunEndsRecorded:
        states: list[RunState | None] = []
        for end in reported.ends:
            try:
                states.append(self._finish(self.runs[end.run_id], end.finish).state)
            except RunGone:  # noqa: PERF203
                states.append(None)
        return RunEndsRecorded(states=states)

    def _service(self) -> ServiceRead:
        return ServiceRead(
            name="a-lab",
            version="0",
            public_url=self.url,
            store_url=self.url,
            store_origin=self.url,
            checksum="sha256",
            has_local_accounts=False,
            viewers=[],
            person=None,
        )

    def _register(self, registration: RunnerRegistration) -> RunnerRead:
        self.registrations.append(registration)
        fields = registration.model_dump(exclude={"labels"})
        return RunnerRead(**fields, labels=registration.labels, last_seen_at=LATER, is_alive=True, active_runs=0)

    def _claim(self, runner_id: uuid.UUID, ask: ClaimRequest) -> ClaimReply:
        until = time.monotonic() + ask.wait_s
        with self._changed:
            self.requested.append(ask)
            claimed: list[RunAssignment] = []
            while not self.is_silent.is_set():
                for run in self.runs.values():
                    expected = run.claim.resources
                    is_lost = (
                        run.runner_id == runner_id and run.claim.run_id not in ask.active_run_ids and not run.finishes
                    )
                    fits = expected.cores <= ask.free.cores and expected.memory_bytes <= ask.free.memory_bytes
                    fits = fits and expected.gpus <= ask.free.gpus and len(claimed) < ask.max_runs
                    if (run.state is RunState.queued or is_lost) and fits:
                        run.state, run.runner_id, run.attempt = RunState.preparing, runner_id, run.attempt + 1
                        run.claim = run.claim.model_copy(update={"attempt": run.attempt})
                        claimed.append(run.claim)
                if claimed:
                    return ClaimReply(run=claimed[0], more=claimed[1:])
                if not self._changed.wait(max(0.0, until - time.monotonic())):
                    break
            return ClaimReply(run=None)

    def _heartbeat(self, runner_id: uuid.UUID, heartbeats: Heartbeats) -> HeartbeatReplies:
        answers = []
        for heartbeat in heartbeats.runs:
            status = self._lease_status(runner_id, heartbeat)
            if status is not LeaseStatus.lost:
                run = self.runs[heartbeat.run_id]
                if not run.states or run.states[-1] is not heartbeat.state:
                    run.states.append(heartbeat.state)
                run.digest = heartbeat.image_digest or run.digest
                run.placement = heartbeat.placement or run.placement
                if heartbeat.progress:
                    run.progress.append(heartbeat.progress)
            answers.append(HeartbeatReply(run_id=heartbeat.run_id, attempt=heartbeat.attempt, status=status))
        for named in heartbeats.unchanged:
            status = self._lease_status(runner_id, named)
            if status is not LeaseStatus.active:
                answers.append(HeartbeatReply(run_id=named.run_id, attempt=named.attempt, status=status))
        return HeartbeatReplies(runs=answers, lease_s=self.lease_s)

    def _lease_status(self, runner_id: uuid.UUID, named: Heartbeat | RunAttempt) -> LeaseStatus:
        run = self.runs.get(named.run_id)
        if run is None or run.runner_id != runner_id or run.attempt != named.attempt or run.finishes:
            return LeaseStatus.lost
        return LeaseStatus.cancel if run.is_cancelled else LeaseStatus.active

    def _check(self, run: FakeRun, attempt: int) -> None:
        if run.attempt != attempt or run.runner_id is None or run.finishes:
            raise RunGone(run_id=str(run.claim.run_id))

    def _keep(self, run: FakeRun, stored: LogChunkConfirm) -> None:
        self._check(run, stored.attempt)
        piece = self._objects[f"log/{run.claim.run_id}/{stored.attempt}/{stored.offset}"]
        assert len(piece) == stored.size_bytes
        if (stored.offset, piece) not in run.segments:
            run.segments.append((stored.offset, piece))

    def _finish(self, run: FakeRun, finish: RunFinish) -> RunFinished:
        if not (run.finishes and run.attempt == finish.attempt):
            self._check(run, finish.attempt)
        if self.report_refusal is not None and finish.report.metrics:
            raise self.report_refusal
        run.finishes.append(finish)
        if finish.log is not None:
            run.artifacts[LOG_PATH] = finish.log
        run.digest = finish.image_digest or run.digest
        ends = {EndReason.done: RunState.done, EndReason.cancelled: RunState.cancelled}
        run.state = ends.get(finish.reason, RunState.failed)
        return RunFinished(state=run.state)

    # -- the store -----------------------------------------------------------------------------------------------------

    def read(self, key: str) -> bytes:
        """Return an object's bytes."""
        self.requests["GET store"] += 1
        _, run_id, path = key.split("/", 2)
        right = self.runs[uuid.UUID(run_id)].inputs[path]
        return self.spoilt.get(path, right)

    def write(self, key: str, data: bytes, sha256: str) -> bool:
        """Take an object's bytes, if they are those that were announced."""
        if self.store_refuses.is_set() or hashlib.sha256(data).hexdigest() != sha256:
            return False
        self._objects[key] = data
        return True
