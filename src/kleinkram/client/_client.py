"""The client: one connection, with one attribute per resource."""

import importlib
import logging
import os
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, cast

from typing_extensions import Self

from kleinkram.client._http import Api
from kleinkram.client.config import Endpoint, find_endpoint
from kleinkram.client.errors import InvalidInput, NothingToDo

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from kleinkram.client._resources import Ref
    from kleinkram.client.search import Condition, FileFields
    from kleinkram.client.transfer import TransferReport
    from kleinkram.contract.files import FileRead
    from kleinkram.contract.metadata import Metadata
    from kleinkram.contract.mission_events import MissionEventRead

    AnyPath = str | os.PathLike[str]

    from kleinkram.client.actions import Actions, ProjectActions
    from kleinkram.client.checks import Checks
    from kleinkram.client.exports import MissionExport
    from kleinkram.client.files import Files, Recordings, Uploads
    from kleinkram.client.metrics import Metrics
    from kleinkram.client.mission_events import MissionEvents
    from kleinkram.client.missions import Missions, Projects
    from kleinkram.client.people import Access, Groups, People
    from kleinkram.client.runs import Runners, Runs
    from kleinkram.client.search import Search, Stats
    from kleinkram.client.server import Admin, Audit, Events, Home, Me, Service, Trash
    from kleinkram.client.tokens import Shares, Tokens
    from kleinkram.client.viewer_layouts import ViewerLayouts
    from kleinkram.recordings.messages import Time
    from kleinkram.recordings.recording import Topics
    from kleinkram.recordings.writing.export import ExportFormat
    from kleinkram.recordings.writing.image_files import ImageOptions
    from kleinkram.recordings.writing.mcap import McapOptions

_log = logging.getLogger("kleinkram")
_MAX_AROUND_S = 86_400

# The modules of resources that are not named after them.
_MODULES = {
    "access": "people",
    "groups": "people",
    "projects": "missions",
    "project_actions": "actions",
    "recordings": "files",
    "runners": "runs",
    "shares": "tokens",
    "stats": "search",
    "uploads": "files",
    **dict.fromkeys(("admin", "audit", "events", "home", "me", "service", "trash"), "server"),
}


class Client:
    """A connection to one Kleinkram server. A context manager; may be shared between threads.

    The module of a resource is imported on first use, which keeps short commands fast.
    """

    projects: "Projects"
    missions: "Missions"
    files: "Files"
    recordings: "Recordings"
    uploads: "Uploads"
    checks: "Checks"
    mission_events: "MissionEvents"
    viewer_layouts: "ViewerLayouts"
    actions: "Actions"
    project_actions: "ProjectActions"
    runs: "Runs"
    runners: "Runners"
    metrics: "Metrics"
    access: "Access"
    groups: "Groups"
    people: "People"
    tokens: "Tokens"
    shares: "Shares"
    trash: "Trash"
    stats: "Stats"
    search: "Search"
    audit: "Audit"
    service: "Service"
    events: "Events"
    home: "Home"
    admin: "Admin"
    me: "Me"

    def __init__(self, endpoint: Endpoint) -> None:
        self._api = Api(endpoint)
        self.endpoint = endpoint

    def upload(
        self,
        paths: "AnyPath | Sequence[AnyPath]",
        mission: "Ref",
        *,
        project: "Ref | None" = None,
        create: bool = False,
        metadata: "Metadata | None" = None,
        exclude: "str | Sequence[str]" = (),
        include_active: bool = False,
        connections: int = 4,
        bytes_per_s: float | None = None,
    ) -> "TransferReport":
        """Upload files and folders to a mission, and return the result for each; the same call again sends the rest.

        A folder keeps its tree, as with `klein upload`. With `create`, a missing mission is created with this metadata.

        Raises:
            NotFound: there is no such mission, and `create` was not given.
            MetadataInvalid: the metadata of the new mission does not satisfy its project.
            NothingToDo: there is no file in these paths.
            ServerUnreachable, StoreUnreachable: one of them stayed unavailable.
        """
        from kleinkram.client.transfer import plan_upload
        from kleinkram.client.transfer.upload import upload
        from kleinkram.contract.errors import NotFound

        globs = [exclude] if isinstance(exclude, str) else exclude
        plan = plan_upload(as_paths(paths), include_active=include_active, exclude=globs)
        if not plan.files and not plan.left_out:
            raise NothingToDo(reason="There is no file in these paths")
        try:
            mission_id = self.missions.get(mission, project=project).id
        except NotFound as error:
            if not create or error.resource_type != "mission" or not isinstance(mission, str):
                raise
            named, _, name = mission.rpartition("/")
            parent = project if project is not None else named or None
            mission_id = self.missions.create(name, project=parent, metadata=metadata).id
        return upload(self, mission_id, plan, connections=connections, bytes_per_s=bytes_per_s)

    def download(
        self,
        what: "Condition | Ref | Iterable[Ref]" = None,
        dest: "AnyPath" = ".",
        *,
        topics: "Topics | None" = None,
        start: "Time | None" = None,
        end: "Time | None" = None,
        nested: bool = False,
        overwrite: bool = False,
        connections: int = 4,
        bytes_per_s: float | None = None,
        **fields: "Unpack[FileFields]",
    ) -> "TransferReport":
        """Download files to a folder, each verified before it gets its name, and return the result for each.

        With `topics`, `start` or `end`, download a slice of each recording instead, as one MCAP at its path:
        `nuc/drive.bag` becomes `nuc/drive.mcap`. Only the index and the chunks that are needed are fetched.

        Args:
            what: a file or its id, a mission, or several; the text of a query, or a filter. Or select by keywords, as
                in `download(dest="data", project="alpine", mission="ridge", topic="*imu*")`.
            dest: the folder; it is created if it is missing.
            topics: names of topics, or globs of them.
            start: earliest log time, inclusive: nanoseconds, an aware datetime, ISO text, or a text such as `10:00`
                (UTC) or `+20s` after the earliest start of the recordings.
            end: latest log time, exclusive.
            nested: write to PROJECT/MISSION/PATH below it.
            overwrite: replace existing files that differ.
            connections: transfers at the same time.
            bytes_per_s: the rate limit.
            **fields: those of `FileFields`.

        Raises:
            NothingToDo: no file matches, nothing was selected, or no recording has any of a slice.
            InvalidInput: the time range is empty, or a text is no time.
            PathsCollide: two files would have the same path.
            DiskFull, DestinationRefused: the folder cannot take them.
            ServerUnreachable, StoreUnreachable: one of them stayed unavailable.
        """
        from kleinkram.client.transfer import SliceRange, download_slices, plan_download, plan_slices
        from kleinkram.client.transfer.download import download

        files, folder = self._select_files(what, fields), Path(as_paths(dest)[0])
        if not files:
            raise NothingToDo(reason="No file matches")
        if (topics, start, end) != (None, None, None):
            if bytes_per_s is not None:
                raise InvalidInput(what="bytes_per_s", reason="it does not limit slices of recordings")
            slices = plan_slices(self, files, folder, nested=nested)
            return download_slices(self, slices, SliceRange(topics, start, end), overwrite=overwrite)
        plan = plan_download(files, folder, nested=nested)
        return download(self, plan, overwrite=overwrite, connections=connections, bytes_per_s=bytes_per_s)

    def cut_events(
        self,
        events: "Iterable[MissionEventRead]",
        dest: "AnyPath" = ".",
        *,
        around_s: float = 5.0,
        topics: "Topics | None" = None,
        options: "McapOptions | None" = None,
    ) -> "TransferReport":
        """Write what was recorded around each event to a folder, as one MCAP each, and return the result for each.

        Only the indexes and the chunks that are needed are fetched. The recordings of the mission at that time are
        merged; of an event that refers to a file or a recording, it is that recording. A file is named after its event
        and the start of that, as in `stumble-2026-05-01T10-00-00.000Z.mcap`, in PROJECT/MISSION/ where the events are
        of several missions. Existing files stay, and are refused.

        Args:
            events: events, as `client.mission_events.list` yields them.
            dest: the folder; it is created if it is missing.
            around_s: the seconds before the start and after the end of an event.
            topics: names of topics, or globs of them.
            options: how the MCAPs are written.

        Raises:
            NothingToDo: there is no event, or nothing was recorded around any.
            ServerUnreachable: the server stayed unavailable.
        """
        from kleinkram.client.transfer.event_slices import cut_event_slices, plan_event_slices

        if not 0 <= around_s < _MAX_AROUND_S:
            raise InvalidInput(what="around_s", reason=f"it is from 0 to {_MAX_AROUND_S:,} s")
        plan = plan_event_slices(events, Path(as_paths(dest)[0]), around_ns=round(around_s * 10**9))
        if not plan.slices and not plan.left_out:
            raise NothingToDo(reason="No event matches")
        return cut_event_slices(self, plan, topics=topics, options=options)

    def export(
        self,
        what: "Condition | Ref | Iterable[Ref]" = None,
        dest: "AnyPath" = "export",
        *,
        to: "ExportFormat | str" = "parquet",
        topics: "Topics | None" = None,
        start: "Time | None" = None,
        end: "Time | None" = None,
        images: "ImageOptions | None" = None,
        nested: bool = True,
        resume: bool = False,
        **fields: "Unpack[FileFields]",
    ) -> "list[MissionExport]":
        """Write topics of recordings as Parquet, CSV or images, and return the result for each mission.

        Each mission has a new folder, DEST/PROJECT/MISSION, with a file for each topic (a folder, for images) over all
        of its recordings, by log time, and `index.json`. Only the indexes and the chunks that are needed are fetched.

        Args:
            what: as in `download`. Recordings that runs made are left out where others are selected.
            dest: the folder.
            to: "parquet", "csv" or "images".
            topics: names or globs of topics; None: all, or all with images.
            start: earliest log time, inclusive, as in `download`.
            end: latest log time, exclusive.
            images: which images, and how.
            nested: with False, write to `dest` itself; all files must be of one mission.
            resume: continue an export that was interrupted.
            **fields: those of `FileFields`.

        Raises:
            NothingToDo: no recording matches, or nothing was selected.
            InvalidInput: the time range is empty, a text is no time, or there are several missions and not `nested`.
            DestinationRefused: the folder of a mission exists, and not `resume`.
            CannotWrite: a folder cannot be written to or is full, or holds another export.
            ServerUnreachable: the server stayed unavailable.
        """
        from kleinkram.client.exports import export_missions, plan_exports
        from kleinkram.recordings.writing.export import ExportFormat, ExportOptions
        from kleinkram.recordings.writing.image_files import ImageOptions

        files = self._select_files(what, fields)
        missions = plan_exports(self, files, Path(as_paths(dest)[0]), nested=nested)
        options = ExportOptions(topics, start, end, images or ImageOptions())
        return export_missions(self, missions, ExportFormat(to), options, resume=resume)

    def _select_files(self, what: "Condition | Ref | Iterable[Ref]", fields: "FileFields") -> "list[FileRead]":
        from kleinkram.contract.files import FileFilter, FileRead
        from kleinkram.contract.missions import MissionRead
        from kleinkram.contract.names import is_id

        if what is None or isinstance(what, FileFilter) or (isinstance(what, str) and not is_id(what)):
            if not what and not fields:
                raise NothingToDo(reason='No files are selected; download("*") downloads all')
            return [*self.files.list("path:*" if what == "*" else what, **fields)]
        files: list[FileRead] = []
        is_one = hasattr(what, "id") or isinstance(what, str) or not isinstance(what, Iterable)
        for item in [cast("Ref", what)] if is_one else cast("Iterable[Ref]", what):
            if isinstance(item, MissionRead):
                narrowed = fields.copy()
                narrowed["mission"] = item
                files += self.files.list(None, **narrowed)
            else:
                files.append(item if isinstance(item, FileRead) else self.files.get(item))
        return files

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the endpoint (see there for its token), without connections."""
        return Client, (self.endpoint,)

    def __repr__(self) -> str:
        return f"<Client of {self.endpoint.url}>"

    def _repr_html_(self) -> str:
        """Return the server, for notebooks."""
        return f"<p>Kleinkram at <b>{escape(self.endpoint.url)}</b> ({escape(self.endpoint.name)})</p>"

    if not TYPE_CHECKING:  # type checkers read the annotations

        def __getattr__(self, name: str) -> object:
            kind = Client.__annotations__.get(name)
            if kind is None:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            made = getattr(importlib.import_module(f"kleinkram.client.{_MODULES.get(name, name)}"), kind)(self._api)
            setattr(self, name, made)
            return made

    def __dir__(self) -> list[str]:
        return [*{*super().__dir__(), *Client.__annotations__}]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._api.close()


def as_paths(paths: "AnyPath | Sequence[AnyPath]") -> "list[AnyPath]":
    """Return one path or several as a list; a string is one path, and keeps a trailing slash."""
    several: object = [paths] if isinstance(paths, str | os.PathLike) else paths
    if not isinstance(several, Iterable) or not all(isinstance(item, str | os.PathLike) for item in several):
        raise InvalidInput(what=f"The path {paths!r}", reason="give a path, or several")
    return [*several]


def connect(url: str | None = None, token: str | None = None) -> Client:
    """Return a client for a server: the one given, else the one configured, else this user's own instance.

    Makes no request. `url` may be the URL of a share link, which includes its secret. Without a token, only public
    projects can be read. `kleinkram.client.config.find_endpoint` defines the order; NotConfigured if it finds none.
    """
    endpoint = find_endpoint(url, token)
    if endpoint.token is None:
        _log.warning("No token for %s: only what is public there is shown (klein login gets one).", endpoint.url)
    return Client(endpoint)
