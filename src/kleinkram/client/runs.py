"""Runs: launch, follow, cancel, and fetch their results; and the requests of runners.

Requests of runners about runs are idempotent, so they are retried while the server is unavailable. A claim is not:
where its answer was lost, the server assigns the run again, since the next claim does not list it as active.
"""

import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

from typing_extensions import TypedDict, Unpack

from kleinkram.client._http import Api, query_of
from kleinkram.client._resources import ApiResource, Listing, Ref, checked, count, known_id, pages, refs_of
from kleinkram.client.actions import Actions
from kleinkram.client.errors import InvalidInput, TimedOut
from kleinkram.client.files import Uploads
from kleinkram.client.missions import Missions, Projects
from kleinkram.contract import runners, runs
from kleinkram.contract.actions import ActionDefinition, ParameterValues
from kleinkram.contract.checks import CheckStatus, Verdict
from kleinkram.contract.files import BlobState, DownloadLink
from kleinkram.contract.previews import MissionPreview
from kleinkram.contract.reports import Report, Severity
from kleinkram.contract.uploads import UploadDecisions, UploadFile

if TYPE_CHECKING:
    from kleinkram.client.transfer import TransferReport, Watcher

ENDS = frozenset({runs.RunState.done, runs.RunState.failed, runs.RunState.cancelled})
# How long the server waits for more of a log during one request.
_LOG_WAIT_S = 20.0
_LOG_PAUSE_S = 0.2
_FIRST_LOOK_S = 0.1
_LOOK_EVERY_S = 1.0


class RunFields(TypedDict, total=False):
    """The keywords that select runs: those of `RunFilter`, with one value or several.

    Projects and missions are a name, an id or an object.
    """

    project: Ref | Sequence[Ref]
    mission: Ref | Sequence[Ref]
    action: str
    state: runs.RunState | str | Sequence[runs.RunState | str]
    verdict: Verdict | str | Sequence[Verdict | str]
    active: bool
    mine: bool


class ReportFields(TypedDict, total=False):
    """The keywords that select checks, findings and metrics alike; projects and missions as above.

    `latest`: only of the latest run that is done, of each mission and action with the same parameters.
    """

    run: Ref
    project: Ref | Sequence[Ref]
    mission: Ref | Sequence[Ref]
    action: str
    version: int
    topic: str
    latest: bool


class CheckFields(ReportFields, total=False):
    """The keywords that select checks: those of `CheckFilter`. `name` may be a glob."""

    name: str
    status: CheckStatus | str | Sequence[CheckStatus | str]


class FindingFields(ReportFields, total=False):
    """The keywords that select findings: those of `FindingFilter`. `code` may be a glob."""

    code: str
    severity: Severity | str | Sequence[Severity | str]


class MetricFields(ReportFields, total=False):
    """The keywords that select metrics: those of `MetricFilter`. `name` may be a glob."""

    name: str


FilterKind = TypeVar("FilterKind", runs.RunFilter, runs.CheckFilter, runs.FindingFilter, runs.MetricFilter)


class Runs(ApiResource):
    """`client.runs`."""

    def launch(
        self,
        action: Ref | ActionDefinition,
        mission_ids: Iterable[Ref],
        *,
        version: int | None = None,
        parameters: ParameterValues | None = None,
        priority: runs.RunPriority = runs.RunPriority.normal,
        force: bool = False,
    ) -> Sequence[runs.RunCreated | runs.RunRefused]:
        """Run an action on each of some missions, and return the outcome for each, in order.

        The action is a published one, in its latest version unless `version` is given; or a definition, which is run
        without being published. Results of an earlier successful run with the same version, parameters and inputs are
        reused, and the run is `done` at once, unless `force`. A mission on which it may not run has a `RunRefused`:
        `priority` high requires DELETE on it.
        """
        what = "definition" if isinstance(action, ActionDefinition) else "action_id"
        if not isinstance(action, ActionDefinition):
            action = Actions(self._api).id_of(action)
        requested: dict[str, object] = {what: action, "parameters": parameters or {}, "priority": priority}
        requested["force"] = force
        if version is not None:
            requested["version"] = version
        missions = Missions(self._api)
        ids, outcomes = [missions.id_of(entry) for entry in mission_ids], []
        for start in range(0, len(ids), runs.MAX_LAUNCHED):
            body = checked(runs.RunsCreate, "The run", mission_ids=ids[start : start + runs.MAX_LAUNCHED], **requested)
            outcomes += self._api.send("POST", "/runs", runs.RunsCreated, body).items
        return outcomes

    def record(
        self,
        name: str,
        mission: Ref,
        *,
        script: str,
        inputs: Sequence[str],
        outputs: Sequence[str] = (),
        parameters: ParameterValues | None = None,
        report: Report | Mapping[str, object] | None = None,
        duration_s: float | None = None,
    ) -> runs.RunRead:
        """Record a run that was executed elsewhere, such as by a pipeline, and return it; again, the same one.

        `script` is the text that was executed. `inputs` and `outputs` are paths of files of the mission; upload the
        outputs before. They become files that the run made, and the numbers of its report are those of any run.
        """
        body = checked(
            runs.RunRecord,
            "The run",
            mission_id=Missions(self._api).id_of(mission),
            name=name,
            script=script,
            inputs=[*inputs],
            outputs=[*outputs],
            parameters=parameters or {},
            report=report or {},
            duration_s=duration_s,
        )
        return self._api.repeat("/runs/recorded", runs.RunRead, body)

    def list(
        self, matching: runs.RunFilter | None = None, *, limit: int | None = None, **fields: Unpack[RunFields]
    ) -> Listing[runs.RunRead]:
        """Yield the runs that match, latest first: `list(project="alpine", state="failed")`, or by a filter."""
        return pages(
            self._api, "/runs", runs.RunRead, query_of(self._filter(runs.RunFilter, matching, fields)), limit=limit
        )

    def count(self, matching: runs.RunFilter | None = None, **fields: Unpack[RunFields]) -> int:
        """Return how many runs match."""
        return count(self._api, "/runs", runs.RunRead, query_of(self._filter(runs.RunFilter, matching, fields)))

    def get(self, run_id: Ref) -> runs.RunDetail:
        """Return a run with its definition, previews, proposed metadata and used resources."""
        return self._api.get(f"/runs/{_run_id(run_id)}", runs.RunDetail)

    def wait(
        self, run_id: Ref, *, timeout_s: float | None = None, seen: Callable[[runs.RunDetail], None] | None = None
    ) -> runs.RunDetail:
        """Return a run once it has ended; `seen` is called with each state. On TimedOut the run goes on.

        `state` says whether it ended well, and `verdict` what it says of the mission, which may be bad.
        """
        began_at, pause_s = time.monotonic(), _FIRST_LOOK_S
        while True:
            run = self.get(run_id)
            if seen is not None:
                seen(run)
            if run.state in ENDS:
                return run
            if timeout_s is not None and time.monotonic() - began_at + pause_s > timeout_s:
                raise TimedOut(what=f"The run {run_id}", seconds=timeout_s)
            time.sleep(pause_s)
            pause_s = min(pause_s * 1.5, _LOOK_EVERY_S)

    def cancel(self, run_id: Ref) -> runs.RunRead:
        """Cancel a run, and return it; its runner ends it within seconds. A run that has ended stays."""
        return self._api.repeat(f"/runs/{_run_id(run_id)}/cancel", runs.RunRead)

    def retry(self, run_id: Ref, *, force: bool = False) -> runs.RunRead:
        """Create a run of the same version with the same parameters on the same mission, and return it.

        It reads the files that match now. With `force`, no earlier results are reused.
        """
        return self._api.send("POST", f"/runs/{_run_id(run_id)}/retry?force={str(force).lower()}", runs.RunRead)

    def inputs(self, run_id: Ref) -> Listing[runs.RunInput]:
        """Yield the inputs of a run, by path."""
        return pages(self._api, f"/runs/{_run_id(run_id)}/inputs", runs.RunInput, [])

    def artifacts(self, run_id: Ref) -> Listing[runs.ArtifactRead]:
        """Yield the artifacts of a run, by path; of a run that reuses results, those of the earlier one."""
        return pages(self._api, f"/runs/{_run_id(run_id)}/artifacts", runs.ArtifactRead, [])

    def artifact_urls(self, run_id: Ref, artifact_ids: Sequence[uuid.UUID]) -> Sequence[runs.ArtifactUrl]:
        """Return where to read the bytes of up to 500 artifacts of a run, in the order asked."""
        body = checked(runs.ArtifactsRequest, "The request", artifact_ids=[*artifact_ids])
        return self._api.repeat(f"/runs/{_run_id(run_id)}/artifacts/download", runs.ArtifactUrls, body).items

    def download_artifacts(
        self,
        run_id: Ref,
        dest: Path,
        *,
        artifacts: Iterable[runs.ArtifactRead] | None = None,
        overwrite: bool = False,
        watcher: "Watcher | None" = None,
    ) -> "TransferReport":
        """Download artifacts of a run, all or some, to a folder and return the result for each.

        As `transfer.download`: each is verified before it gets its name, and the same call again resumes.
        """
        from kleinkram.client.transfer.download import fetch
        from kleinkram.client.transfer.download_target import DownloadPlan  # imports the client

        plan = DownloadPlan()
        for artifact in self.artifacts(run_id) if artifacts is None else artifacts:
            plan.add(artifact, dest, artifact.path)

        def links(ids: Sequence[uuid.UUID]) -> Sequence[DownloadLink]:
            return [_as_link(entry) for entry in self.artifact_urls(run_id, ids)]

        return fetch(links, self._api.endpoint.url, plan, overwrite=overwrite, watcher=watcher)

    def download_previews(
        self,
        previews: Iterable[MissionPreview],
        dest: Path,
        *,
        overwrite: bool = False,
        watcher: "Watcher | None" = None,
    ) -> "TransferReport":
        """Download previews of missions, as `client.missions.previews` returns them; those of each action to a folder.

        As `download_artifacts`: each is verified before it gets its name, and the same call again resumes.
        """
        from kleinkram.client.transfer.download import fetch
        from kleinkram.client.transfer.download_target import DownloadPlan  # imports the client

        plan = DownloadPlan()
        run_ids: dict[uuid.UUID, uuid.UUID] = {}
        for preview in previews:
            run_ids[preview.artifact_id] = preview.run_id
            same = preview.model_dump(include={"run_id", "path", "size_bytes", "sha256"})
            artifact = runs.ArtifactRead(id=preview.artifact_id, file_id=None, **same)
            plan.add(artifact, dest, f"{preview.action.name}/{preview.path}")

        def links(ids: Sequence[uuid.UUID]) -> Sequence[DownloadLink]:
            links_by_id: dict[uuid.UUID, DownloadLink] = {}
            for run_id in {run_ids[artifact_id] for artifact_id in ids}:
                own = [artifact_id for artifact_id in ids if run_ids[artifact_id] == run_id]
                links_by_id |= {link.artifact.id: _as_link(link) for link in self.artifact_urls(run_id, own)}
            return [links_by_id[artifact_id] for artifact_id in ids]

        return fetch(links, self._api.endpoint.url, plan, overwrite=overwrite, watcher=watcher)

    def checks(
        self, matching: runs.CheckFilter | None = None, *, limit: int | None = None, **fields: Unpack[CheckFields]
    ) -> Listing[runs.CheckRead]:
        """Yield the checks that runs reported: `checks(mission=mission, status=["warning", "error"], latest=True)`."""
        query = query_of(self._filter(runs.CheckFilter, matching, fields))
        return pages(self._api, "/run-checks", runs.CheckRead, query, limit=limit)

    def findings(
        self, matching: runs.FindingFilter | None = None, *, limit: int | None = None, **fields: Unpack[FindingFields]
    ) -> Listing[runs.FindingRead]:
        """Yield the findings of runs: `findings(project="alpine", code="imu.*", latest=True)`."""
        query = query_of(self._filter(runs.FindingFilter, matching, fields))
        return pages(self._api, "/findings", runs.FindingRead, query, limit=limit)

    def metrics(
        self, matching: runs.MetricFilter | None = None, *, limit: int | None = None, **fields: Unpack[MetricFields]
    ) -> Listing[runs.MetricRead]:
        """Yield the metrics of runs, with parameters and version: `metrics(name="ate_rmse", latest=True)`."""
        query = query_of(self._filter(runs.MetricFilter, matching, fields))
        return pages(self._api, "/run-metrics", runs.MetricRead, query, limit=limit)

    def log(self, run_id: Ref, *, follow: bool = False) -> Iterator[runs.LogChunkRead]:
        """Yield the log of a run in pieces of complete lines; with `follow`, until the run ends.

        If the run starts again because its runner was lost, the pieces of the next attempt follow.
        """
        attempt, offset, wait_s = 0, 0, 0.0
        while True:
            requested_at = time.monotonic()
            query = query_of(None, offset=offset, wait_s=wait_s)
            piece = self._api.get(f"/runs/{_run_id(run_id)}/log", runs.LogChunkRead, query)
            is_new_attempt = piece.attempt != attempt and offset > 0
            attempt, offset = piece.attempt, 0 if is_new_attempt else piece.next_offset
            if is_new_attempt:
                continue
            if piece.text:
                yield piece
            if piece.is_over or not (piece.text or follow):
                return
            wait_s = _LOG_WAIT_S if follow else 0.0
            if not piece.text and time.monotonic() - requested_at < _LOG_PAUSE_S:
                time.sleep(_LOG_PAUSE_S)

    def _filter(
        self, kind: type[FilterKind], matching: FilterKind | None, fields: Mapping[str, object]
    ) -> FilterKind | None:
        """Return the filter of keywords and a filter together."""
        if not fields:
            return matching
        selected = with_ids(self._api, fields)
        if (run := selected.pop("run", None)) is not None:
            selected["run_id"] = known_id(cast(Ref, run), "run") or run
        for name in ("state", "severity", "status", "verdict"):
            if isinstance(selected.get(name), str):
                selected[name] = [selected[name]]
        requested = matching.model_dump(exclude_defaults=True) if matching else {}
        return checked(kind, "The filter", **requested, **selected)


def with_ids(api: Api, fields: Mapping[str, object]) -> dict[str, object]:
    """Return the fields of a filter with the ids of `project` and `mission`, each one or several."""
    selected = dict(fields)
    projects: list[uuid.UUID] = []
    if (value := selected.pop("project", None)) is not None:
        projects = [Projects(api).id_of(cast(Ref, ref)) for ref in refs_of("project", value)]
        selected["project_ids"] = projects
    if (value := selected.pop("mission", None)) is not None:
        project_id = projects[0] if len(projects) == 1 else None
        ids = []
        for ref in cast(list[Ref], refs_of("mission", value)):
            is_qualified = isinstance(ref, str) and "/" in ref
            ids.append(Missions(api).id_of(ref, project=None if is_qualified else project_id))
        selected["mission_ids"] = ids
    return selected


def _run_id(ref: Ref) -> uuid.UUID:
    if (run_id := known_id(ref, "run")) is None:
        raise InvalidInput(what=f"The run {ref!r}", reason="give its id; `klein run list` shows them")
    return run_id


def _as_link(artifact: runs.ArtifactUrl) -> DownloadLink:
    return DownloadLink(
        file_id=artifact.artifact.id,
        path=artifact.artifact.path,
        size_bytes=artifact.artifact.size_bytes,
        sha256=artifact.artifact.sha256,
        crc64nvme=None,
        state=BlobState.stored,
        url=artifact.url,
        expires_at=artifact.expires_at,
    )


class Runners(ApiResource):
    """`client.runners`."""

    def list(self) -> Listing[runners.RunnerRead]:
        """List all runners."""
        return pages(self._api, "/runners", runners.RunnerRead, [])

    def register(self, registration: runners.RunnerRegistration) -> runners.RunnerRead:
        """Register a runner, or update its description."""
        return self._api.repeat("/runners", runners.RunnerRead, registration)

    def claim(self, runner_id: uuid.UUID, request: runners.ClaimRequest) -> Sequence[runners.RunAssignment]:
        """Wait for runs, and return at most as many as requested."""
        reply = self._api.send("POST", f"/runners/{runner_id}/claims", runners.ClaimReply, request)
        return [] if reply.run is None else [reply.run, *reply.more]

    def send_heartbeats(self, runner_id: uuid.UUID, heartbeats: runners.Heartbeats) -> runners.HeartbeatReplies:
        """Send the states of all runs, and renew their leases."""
        return self._api.send("POST", f"/runners/{runner_id}/heartbeats", runners.HeartbeatReplies, heartbeats)

    def get_context(self, run_id: uuid.UUID, attempt: runners.Attempt) -> runs.RunContext:
        """Return the content of `/in/mission.json`."""
        return self._api.get(f"/runner/runs/{run_id}/context", runs.RunContext, [("attempt", str(attempt))])

    def get_contexts(
        self, runner_id: uuid.UUID, requested: Sequence[runners.RunAttempt]
    ) -> Sequence[runs.RunContext | None]:
        """Return the contents of `/in/mission.json` of at most `MAX_RUNS` runs; None for runs that are not its own."""
        body = runners.ContextsRequest(runs=[*requested])
        return self._api.repeat(f"/runners/{runner_id}/contexts", runners.RunContexts, body).contexts

    def sign_inputs(self, run_id: uuid.UUID, request: runners.InputsRequest) -> runners.InputUrls:
        """Return URLs of inputs."""
        return self._api.repeat(f"/runner/runs/{run_id}/inputs", runners.InputUrls, request)

    def create_log_chunk(self, run_id: uuid.UUID, chunk: runners.LogChunkCreate) -> runners.LogChunkUpload:
        """Return where to PUT a chunk of the log."""
        return self._api.repeat(f"/runner/runs/{run_id}/log-chunks", runners.LogChunkUpload, chunk)

    def confirm_log_chunk(self, run_id: uuid.UUID, chunk: runners.LogChunkConfirm) -> None:
        """Confirm that a chunk of the log was uploaded."""
        self._api.post(f"/runner/runs/{run_id}/log-chunks/confirm", chunk)

    def uploads(self, attempt: runners.Attempt) -> "ArtifactUploads":
        """Return the upload protocol for artifacts of this attempt at a run."""
        return ArtifactUploads(self._api, attempt)

    def finish(self, run_id: uuid.UUID, finish: runners.RunFinish) -> runners.RunFinished:
        """Report the end of a run."""
        return self._api.repeat(f"/runner/runs/{run_id}/finish", runners.RunFinished, finish)

    def finish_all(self, runner_id: uuid.UUID, ends: Sequence[runners.RunEnd]) -> Sequence[runs.RunState | None]:
        """Report the ends of at most `MAX_RUNS` runs; return their states, None for runs that are not its own."""
        body = runners.RunEnds(ends=[*ends])
        return self._api.repeat(f"/runners/{runner_id}/ends", runners.RunEndsRecorded, body).states


class ArtifactUploads(Uploads):
    """The upload protocol for artifacts: `begin` takes the id of a run."""

    def __init__(self, api: Api, attempt: runners.Attempt) -> None:
        super().__init__(api)
        self._attempt = attempt

    def begin(self, run_id: uuid.UUID, files: Sequence[UploadFile]) -> UploadDecisions:
        """Announce up to 200 artifacts of the run and return what to do with each, in the order given."""
        body = runners.ArtifactUploadsCreate(attempt=self._attempt, files=[*files])
        return self._api.repeat(f"/runner/runs/{run_id}/uploads", UploadDecisions, body)
