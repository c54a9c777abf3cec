"""Runners: a list for admins, and the requests of a runner.

Requests about runs are idempotent, so they are repeated while the server is unavailable. A claim is not: where its
answer was lost, the server assigns the run again, since the next claim does not list it as active.
"""

import uuid
from collections.abc import Callable, Sequence

from kleinkram.client._http import PATIENCE_S, Api
from kleinkram.client._nouns import Listing, pages
from kleinkram.client.uploads import Uploads
from kleinkram.contract.runners import (
    ArtifactUploadsCreate,
    Attempt,
    ClaimReply,
    ClaimRequest,
    HeartbeatReplies,
    Heartbeats,
    InputsRequest,
    InputUrls,
    LogChunkConfirm,
    LogChunkCreate,
    LogChunkUpload,
    RunAssignment,
    RunFinish,
    RunFinished,
    RunnerRead,
    RunnerRegistration,
)
from kleinkram.contract.runs import RunContext
from kleinkram.contract.uploads import UploadDecisions, UploadFile


class Runners:
    """`client.runners`. `patience_s` is how long to retry while the server is unavailable; `wait` waits meanwhile."""

    def __init__(
        self, api: Api, *, patience_s: float = PATIENCE_S, wait: Callable[[float], object] | None = None
    ) -> None:
        self._api = api
        self._patience_s = patience_s
        self._wait = wait

    def with_patience(self, patience_s: float, wait: Callable[[float], object]) -> "Runners":
        """Return a client with another retry timeout."""
        return Runners(self._api, patience_s=patience_s, wait=wait)

    def list(self) -> Listing[RunnerRead]:
        """List all runners."""
        return pages(self._api, "/runners", RunnerRead, [])

    def register(self, registration: RunnerRegistration) -> RunnerRead:
        """Register a runner, or update its description."""
        return self._api.repeat("/runners", RunnerRead, registration, patience_s=self._patience_s, wait=self._wait)

    def claim(self, runner_id: uuid.UUID, request: ClaimRequest) -> RunAssignment | None:
        """Wait for a run and return it; None where there is none."""
        return self._api.send("POST", f"/runners/{runner_id}/claims", ClaimReply, request).run

    def send_heartbeats(self, runner_id: uuid.UUID, heartbeats: Heartbeats) -> HeartbeatReplies:
        """Send the states of all runs, and renew their leases."""
        return self._api.send("POST", f"/runners/{runner_id}/heartbeats", HeartbeatReplies, heartbeats)

    def get_context(self, run_id: uuid.UUID, attempt: Attempt) -> RunContext:
        """Return the content of `/in/mission.json`."""
        return self._api.get(f"/runner/runs/{run_id}/context", RunContext, [("attempt", str(attempt))])

    def sign_inputs(self, run_id: uuid.UUID, request: InputsRequest) -> InputUrls:
        """Return URLs of inputs."""
        path = f"/runner/runs/{run_id}/inputs"
        return self._api.repeat(path, InputUrls, request, patience_s=self._patience_s, wait=self._wait)

    def create_log_chunk(self, run_id: uuid.UUID, chunk: LogChunkCreate) -> LogChunkUpload:
        """Return where to PUT a chunk of the log."""
        path = f"/runner/runs/{run_id}/log-chunks"
        return self._api.repeat(path, LogChunkUpload, chunk, patience_s=self._patience_s, wait=self._wait)

    def confirm_log_chunk(self, run_id: uuid.UUID, chunk: LogChunkConfirm) -> None:
        """Confirm that a chunk of the log was uploaded."""
        self._api.tell(f"/runner/runs/{run_id}/log-chunks/confirm", chunk, patience_s=self._patience_s, wait=self._wait)

    def uploads(self, run_id: uuid.UUID, attempt: Attempt) -> "ArtifactUploads":
        """Return the upload protocol for artifacts of a run."""
        return ArtifactUploads(self._api, run_id, attempt, patience_s=self._patience_s, wait=self._wait)

    def finish(self, run_id: uuid.UUID, finish: RunFinish) -> RunFinished:
        """Report the end of a run."""
        path = f"/runner/runs/{run_id}/finish"
        return self._api.repeat(path, RunFinished, finish, patience_s=self._patience_s, wait=self._wait)


class ArtifactUploads(Uploads):
    """The upload protocol for artifacts: `begin` takes the id of the run."""

    def __init__(
        self,
        api: Api,
        run_id: uuid.UUID,
        attempt: Attempt,
        *,
        patience_s: float = PATIENCE_S,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        super().__init__(api, patience_s=patience_s, wait=wait)
        self._run_id = run_id
        self._attempt = attempt

    def with_patience(self, patience_s: float, wait: Callable[[float], object]) -> "ArtifactUploads":
        """Return a client with another retry timeout."""
        return ArtifactUploads(self._api, self._run_id, self._attempt, patience_s=patience_s, wait=wait)

    def begin(self, mission_id: uuid.UUID, files: Sequence[UploadFile]) -> UploadDecisions:
        """Announce up to 200 artifacts of the run and return what to do with each, in the order given."""
        body = ArtifactUploadsCreate(attempt=self._attempt, files=[*files])
        path = f"/runner/runs/{mission_id}/uploads"
        return self._api.repeat(path, UploadDecisions, body, patience_s=self._patience_s, wait=self._wait)
