"""Runs, for programs: launch, follow, end, and fetch what they said and left."""

import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

from typing_extensions import TypedDict, Unpack

from kleinkram.client._http import Api, query_of
from kleinkram.client._nouns import Listing, Ref, checked, count, known_id, pages, refs_of
from kleinkram.client.actions import Actions
from kleinkram.client.errors import InvalidInput, TimedOut
from kleinkram.client.missions import Missions
from kleinkram.client.projects import Projects
from kleinkram.contract.actions import ActionDefinition, ParameterValues
from kleinkram.contract.files import BlobState, DownloadLink
from kleinkram.contract.reports import Severity
from kleinkram.contract.runs import (
    MAX_LAUNCHED,
    ArtifactRead,
    ArtifactsRequest,
    ArtifactUrl,
    ArtifactUrls,
    FindingRead,
    LogChunkRead,
    MetricRead,
    ReportFilter,
    RunCreated,
    RunDetail,
    RunFilter,
    RunInput,
    RunRead,
    RunRefused,
    RunsCreate,
    RunsCreated,
    RunState,
)

if TYPE_CHECKING:
    from kleinkram.client.transfer import TransferReport, Watcher

ENDS = frozenset({RunState.done, RunState.failed, RunState.cancelled})
# How long one request for more of a log waits in the server.
_LOG_WAIT_S = 20.0
_LOG_PAUSE_S = 0.2
_FIRST_LOOK_S = 0.1
_LOOK_EVERY_S = 1.0


class RunFields(TypedDict, total=False):
    """The keywords that say which runs: `RunFilter`'s, with places by name, id, or as they are; one or several."""

    project: Ref | Sequence[Ref]
    mission: Ref | Sequence[Ref]
    action: str
    state: RunState | str | Sequence[RunState | str]
    active: bool
    mine: bool


class SayingFields(TypedDict, total=False):
    """The keywords that say which findings or metrics: `ReportFilter`'s, with places as in `RunFields`."""

    run: Ref
    project: Ref | Sequence[Ref]
    mission: Ref | Sequence[Ref]
    code: str
    severity: Severity | str | Sequence[Severity | str]


FilterKind = TypeVar("FilterKind", RunFilter, ReportFilter)


class Runs:
    """`client.runs`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def launch(
        self,
        action: Ref | ActionDefinition,
        mission_ids: Iterable[Ref],
        *,
        version: int | None = None,
        parameters: ParameterValues | None = None,
        force: bool = False,
    ) -> Sequence[RunCreated | RunRefused]:
        """Run an action on each of some missions, and return how it went with each, in order, however many they are.

        The action is a published one by its id, in its latest version unless another is named; or a definition, which
        is run without being published. Results of an earlier good run with the very same version, parameters and inputs
        are taken over, and the run is `done` at once, unless `force`. A mission on which it may not run has a
        `RunRefused`, and keeps no other from being run.

        Raises:
            InvalidInput: the request cannot be made of these.
            NotFound: there is no such action, or no such version of it.
        """
        what = "definition" if isinstance(action, ActionDefinition) else "action_id"
        if not isinstance(action, ActionDefinition):
            action = known_id(action, "action") or Actions(self._api).get(action).id
        said: dict[str, object] = {what: action, "parameters": parameters or {}, "force": force}
        if version is not None:
            said["version"] = version
        missions = Missions(self._api)
        ids, outcomes = [missions.id_of(each) for each in mission_ids], []
        for start in range(0, len(ids), MAX_LAUNCHED):
            body = checked(RunsCreate, "The run", mission_ids=ids[start : start + MAX_LAUNCHED], **said)
            outcomes += self._api.send("POST", "/runs", RunsCreated, body).items
        return outcomes

    def list(
        self, matching: RunFilter | None = None, *, limit: int | None = None, **fields: Unpack[RunFields]
    ) -> Listing[RunRead]:
        """Yield the runs that match, latest first: `list(project="alpine", state="failed")`, or by a filter."""
        return pages(self._api, "/runs", RunRead, query_of(self._filter(RunFilter, matching, fields)), limit=limit)

    def count(self, matching: RunFilter | None = None, **fields: Unpack[RunFields]) -> int:
        """Return how many runs match."""
        return count(self._api, "/runs", RunRead, query_of(self._filter(RunFilter, matching, fields)))

    def get(self, run_id: Ref) -> RunDetail:
        """Return a run with its definition, previews, proposed metadata and what it used.

        Raises:
            NotFound: there is none with this id.
            InvalidInput: it is no id.
        """
        return self._api.get(f"/runs/{_run_id(run_id)}", RunDetail)

    def wait(
        self,
        run_id: Ref,
        *,
        timeout_s: float | None = None,
        seen: Callable[[RunDetail], None] | None = None,
    ) -> RunDetail:
        """Return a run once it is over, well or not; `seen` is called with it whenever it was looked at.

        Raises:
            TimedOut: it was not over by then; it goes on.
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

    def cancel(self, run_id: Ref) -> RunRead:
        """Have a run ended, and return it: its runner does so within seconds. Nothing happens to one that is over."""
        return self._api.understood(RunRead, "cancel", self._api.post_empty(f"/runs/{_run_id(run_id)}/cancel"))

    def retry(self, run_id: Ref, *, force: bool = False) -> RunRead:
        """Make a new run of the same version with the same parameters on the same mission, and return it.

        It reads the files that match now. With `force`, it takes over no results of an earlier one.
        """
        return self._api.send("POST", f"/runs/{_run_id(run_id)}/retry?force={str(force).lower()}", RunRead)

    def inputs(self, run_id: Ref) -> Listing[RunInput]:
        """Yield the files that a run was given, by path."""
        return pages(self._api, f"/runs/{_run_id(run_id)}/inputs", RunInput, [])

    def artifacts(self, run_id: Ref) -> Listing[ArtifactRead]:
        """Yield the files that a run left, by path; of one that took over results, those of the earlier one."""
        return pages(self._api, f"/runs/{_run_id(run_id)}/artifacts", ArtifactRead, [])

    def artifact_urls(self, run_id: Ref, artifact_ids: Sequence[uuid.UUID]) -> Sequence[ArtifactUrl]:
        """Return where to read the bytes of up to 500 artifacts of a run, in the order asked."""
        body = checked(ArtifactsRequest, "The request", artifact_ids=[*artifact_ids])
        return self._api.repeat(f"/runs/{_run_id(run_id)}/artifacts/download", ArtifactUrls, body).items

    def download_artifacts(
        self,
        run_id: Ref,
        dest: Path,
        *,
        artifacts: Iterable[ArtifactRead] | None = None,
        overwrite: bool = False,
        watcher: "Watcher | None" = None,
    ) -> "TransferReport":
        """Download what a run left, or some of it, into a folder and return how each ended.

        As `transfer.download`: each is verified before it gets its name, and the same call again resumes.

        Raises:
            DiskFull: there is no room for all of it.
            ServerUnreachable, StoreUnreachable: one of them stayed away.
        """
        from kleinkram.client.transfer.destination import plan_artifacts  # transfers know the client
        from kleinkram.client.transfer.download import fetch

        plan = plan_artifacts(self.artifacts(run_id) if artifacts is None else artifacts, dest)

        def links(ids: Sequence[uuid.UUID]) -> Sequence[DownloadLink]:
            return [_as_link(each) for each in self.artifact_urls(run_id, ids)]

        return fetch(links, self._api.endpoint.url, plan, overwrite=overwrite, watcher=watcher)

    def findings(
        self, matching: ReportFilter | None = None, *, limit: int | None = None, **fields: Unpack[SayingFields]
    ) -> Listing[FindingRead]:
        """Yield what runs have noticed."""
        return pages(
            self._api, "/findings", FindingRead, query_of(self._filter(ReportFilter, matching, fields)), limit=limit
        )

    def metrics(
        self, matching: ReportFilter | None = None, *, limit: int | None = None, **fields: Unpack[SayingFields]
    ) -> Listing[MetricRead]:
        """Yield the numbers that runs have found; the filter's `code` is a metric's name."""
        return pages(
            self._api, "/run-metrics", MetricRead, query_of(self._filter(ReportFilter, matching, fields)), limit=limit
        )

    def log(self, run_id: Ref, *, follow: bool = False) -> Iterator[LogChunkRead]:
        """Yield what a run has written, from the beginning, in pieces of whole lines; with `follow`, until it is over.

        Where a lost runner made it begin anew, the pieces of the next attempt follow, and `attempt` says so.
        """
        attempt, offset, wait_s = 0, 0, 0.0
        while True:
            asked_at = time.monotonic()
            query = query_of(None, offset=offset, wait_s=wait_s)
            piece = self._api.get(f"/runs/{_run_id(run_id)}/log", LogChunkRead, query)
            begins_anew = piece.attempt != attempt and offset > 0
            attempt, offset = piece.attempt, 0 if begins_anew else piece.next_offset
            if begins_anew:
                continue
            if piece.text:
                yield piece
            if piece.is_over or not (piece.text or follow):
                return
            wait_s = _LOG_WAIT_S if follow else 0.0
            if not piece.text and time.monotonic() - asked_at < _LOG_PAUSE_S:
                time.sleep(_LOG_PAUSE_S)

    def _filter(
        self, kind: type[FilterKind], matching: FilterKind | None, fields: Mapping[str, object]
    ) -> FilterKind | None:
        """Return the filter that keywords and a filter say together.

        Raises:
            InvalidInput: a keyword is unknown, or its value is not usable.
            NotFound: there is no such project or mission.
        """
        if not fields:
            return matching
        given = dict(fields)
        projects: list[uuid.UUID] = []
        if (value := given.pop("project", None)) is not None:
            projects = [Projects(self._api).id_of(cast(Ref, ref)) for ref in refs_of("project", value)]
            given["project_ids"] = projects
        if (value := given.pop("mission", None)) is not None:
            within = projects[0] if len(projects) == 1 else None
            given["mission_ids"] = [self._mission_id(cast(Ref, ref), within) for ref in refs_of("mission", value)]
        if (run := given.pop("run", None)) is not None:
            given["run_id"] = known_id(cast(Ref, run), "run") or run
        for name in ("state", "severity"):
            if isinstance(given.get(name), str):
                given[name] = [given[name]]
        said = matching.model_dump(exclude_defaults=True) if matching else {}
        return checked(kind, "The filter", **said, **given)

    def _mission_id(self, ref: Ref, project_id: uuid.UUID | None) -> uuid.UUID:
        says_project = isinstance(ref, str) and "/" in ref
        return Missions(self._api).id_of(ref, project=None if says_project else project_id)


def _run_id(ref: Ref) -> uuid.UUID:
    if (run_id := known_id(ref, "run")) is None:
        raise InvalidInput(what=f"The run {ref!r}", reason="say its id; `klein run list` shows them")
    return run_id


def _as_link(artifact: ArtifactUrl) -> DownloadLink:
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
