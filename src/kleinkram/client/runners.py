"""Runners: who runs what, for admins; and what a runner itself says to its server, request by request.

All that a runner says about a run may be said again, so it outlasts a server that is away for a while. All but asking
for a run: what the server gave in an answer that never came, it takes back once the runner says what it holds.
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
    """`client.runners`. `patience_s` is how long a server may be away; `wait` is what waits meanwhile."""

    def __init__(
        self, api: Api, *, patience_s: float = PATIENCE_S, wait: Callable[[float], object] | None = None
    ) -> None:
        self._api = api
        self._patience_s = patience_s
        self._wait = wait

    def with_patience(self, patience_s: float, wait: Callable[[float], object]) -> "Runners":
        """Return the same with other patience."""
        return Runners(self._api, patience_s=patience_s, wait=wait)

    def list(self) -> Listing[RunnerRead]:
        """Yield all runners."""
        return pages(self._api, "/runners", RunnerRead, [])

    def hello(self, hello: RunnerRegistration) -> RunnerRead:
        """Say, as a runner, what it is."""
        return self._api.repeat("/runners", RunnerRead, hello, patience_s=self._patience_s, wait=self._wait)

    def claim(self, runner_id: uuid.UUID, ask: ClaimRequest) -> RunAssignment | None:
        """Wait for a run and return it; None where none came that fits."""
        return self._api.send("POST", f"/runners/{runner_id}/claims", ClaimReply, ask).run

    def beat(self, runner_id: uuid.UUID, beats: Heartbeats) -> HeartbeatReplies:
        """Say what all runs are at, and hear what becomes of them."""
        return self._api.send("POST", f"/runners/{runner_id}/heartbeats", HeartbeatReplies, beats)

    def context(self, run_id: uuid.UUID, attempt: Attempt) -> RunContext:
        """Return what a run is told."""
        return self._api.get(f"/runner/runs/{run_id}/context", RunContext, [("attempt", str(attempt))])

    def inputs(self, run_id: uuid.UUID, ask: InputsRequest) -> InputUrls:
        """Return where to GET some inputs."""
        path = f"/runner/runs/{run_id}/inputs"
        return self._api.repeat(path, InputUrls, ask, patience_s=self._patience_s, wait=self._wait)

    def create_log_chunk(self, run_id: uuid.UUID, ask: LogChunkCreate) -> LogChunkUpload:
        """Return where to PUT a piece of the log."""
        path = f"/runner/runs/{run_id}/log-chunks"
        return self._api.repeat(path, LogChunkUpload, ask, patience_s=self._patience_s, wait=self._wait)

    def confirm_log_chunk(self, run_id: uuid.UUID, kept: LogChunkConfirm) -> None:
        """Say that a piece of the log is stored."""
        self._api.tell(f"/runner/runs/{run_id}/log-chunks/confirm", kept, patience_s=self._patience_s, wait=self._wait)

    def uploads(self, run_id: uuid.UUID, attempt: Attempt) -> "ArtifactUploads":
        """Return the upload protocol for what a run leaves."""
        return ArtifactUploads(self._api, run_id, attempt, patience_s=self._patience_s, wait=self._wait)

    def finish(self, run_id: uuid.UUID, finish: RunFinish) -> RunFinished:
        """Say how a run ended."""
        path = f"/runner/runs/{run_id}/finish"
        return self._api.repeat(path, RunFinished, finish, patience_s=self._patience_s, wait=self._wait)


class ArtifactUploads(Uploads):
    """The upload protocol into a run instead of a mission: `begin` takes the run's id."""

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
        """Return the same with other patience."""
        return ArtifactUploads(self._api, self._run_id, self._attempt, patience_s=patience_s, wait=wait)

    def begin(self, mission_id: uuid.UUID, files: Sequence[UploadFile]) -> UploadDecisions:
        """Announce up to 200 artifacts of the run and return what to do with each, in the order given."""
        body = ArtifactUploadsCreate(attempt=self._attempt, files=[*files])
        path = f"/runner/runs/{mission_id}/uploads"
        return self._api.repeat(path, UploadDecisions, body, patience_s=self._patience_s, wait=self._wait)
