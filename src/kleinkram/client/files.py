"""Files and their topics, recordings read from the store in ranges, and the requests of the upload protocol.

`if_match` is the ETag that a file must still have to be changed, else EditConflict.
"""

import datetime
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from typing_extensions import Unpack

from kleinkram.client._http import query_of
from kleinkram.client._resources import (
    ApiResource,
    Listing,
    NamedResource,
    Ref,
    checked,
    count,
    known_id,
    pages,
    resolve_one,
)
from kleinkram.client.errors import InvalidInput, PreviewMissing, ReadingMissing
from kleinkram.client.missions import Missions
from kleinkram.client.search import Condition, FileFields, as_filter
from kleinkram.contract import uploads as protocol
from kleinkram.contract.errors import KleinkramError, NotFound
from kleinkram.contract.files import (
    DownloadLink,
    DownloadLinks,
    DownloadRequest,
    FileFilter,
    FileRead,
    FileSort,
    FileUpdate,
    RecordingRead,
    TopicRead,
)
from kleinkram.contract.names import is_id
from kleinkram.contract.projects import Deleted
from kleinkram.contract.recording_previews import RecordingPreviewRead, RecordingPreviewState
from kleinkram.contract.runs import LineageRead
from kleinkram.contract.search import MAX_LABELLED, FileLabelled, FilesLabelled, LabelChange, TopicFound

if TYPE_CHECKING:
    from kleinkram.recordings import Recording
    from kleinkram.recordings.http_source import HttpSource
    from kleinkram.recordings.previews import RecordingPreview

_METADATA = "metadata.yaml"
_MAX_LINKS = 500
_MAX_PREVIEW_BYTES = 20 * 10**6


class Files(NamedResource[FileRead]):
    """`client.files`."""

    _resource_type = "file"

    def list(
        self,
        matching: Condition = None,
        *,
        sort: FileSort | str | None = None,
        limit: int | None = None,
        **fields: Unpack[FileFields],
    ) -> Listing[FileRead]:
        """Yield the files that match, by project, mission and path unless `sort` says otherwise.

        Here and below, select by keywords, as in `list(project="alpine", topic="*imu*")` (those of `FileFields`), by
        the text of a query such as `"topic:/imu -label:night"`, by both, or by a filter.
        """
        query = query_of(as_filter(matching, fields), sort=sort)
        return pages(self._api, "/files", FileRead, query, limit=limit)

    def count(self, matching: Condition = None, **fields: Unpack[FileFields]) -> int:
        """Return how many files match."""
        return count(self._api, "/files", FileRead, query_of(as_filter(matching, fields)))

    def get(self, ref: Ref, *, mission: Ref | None = None, project: Ref | None = None) -> FileRead:
        """Return the file with this id, or this path (in that mission).

        Raises:
            NotFound: there is none, or no such mission or project.
            AmbiguousName: several missions have one of that path.
        """
        if (file_id := known_id(ref, "file")) is not None:
            return self._api.get(f"/files/{file_id}", FileRead)
        path = str(ref)
        fields: FileFields = {"path": path}
        if mission is not None:
            fields["mission"] = Missions(self._api).id_of(mission, project=project)
        elif project is not None:
            fields["project"] = project
        scope = as_filter(None, fields)
        return resolve_one("file", path, self.list(scope), name=lambda row: row.path, label=file_label)

    def topics(self, file_id: Ref) -> Listing[TopicRead]:
        """Yield the topics of one file, by name."""
        return pages(self._api, f"/files/{self.id_of(file_id)}/topics", TopicRead, [])

    def lineage(self, file_id: Ref) -> LineageRead:
        """Return which run created a file and from what, and which runs read it and what they created."""
        return self._api.get(f"/files/{self.id_of(file_id)}/lineage", LineageRead)

    def find_topics(
        self, matching: Condition = None, *, limit: int | None = None, **fields: Unpack[FileFields]
    ) -> Listing[TopicRead]:
        """Yield the topics of all files that match; the filter's topic and type globs narrow the topics too."""
        return pages(self._api, "/topics", TopicRead, query_of(as_filter(matching, fields)), limit=limit)

    def topics_found(self, matching: Condition = None, **fields: Unpack[FileFields]) -> Sequence[TopicFound]:
        """Return each topic of the files that match once, by name and type, over all files."""
        files: dict[tuple[str, str | None], int] = {}
        messages: dict[tuple[str, str | None], int | None] = {}
        for row in self.find_topics(matching, **fields):
            key = (row.name, row.message_type)
            files[key] = files.get(key, 0) + 1
            messages[key] = row.count if messages.get(key) is None else (messages[key] or 0) + (row.count or 0)
        return [
            TopicFound(name=name, message_type=kind, file_count=count, message_count=messages[name, kind])
            for (name, kind), count in sorted(files.items(), key=lambda item: (item[0][0], item[0][1] or ""))
        ]

    def update(
        self, file_id: Ref, *, if_match: str | None = None, **changes: str | uuid.UUID | Sequence[str]
    ) -> FileRead:
        """Change some fields of `FileUpdate`: a path renames, a `mission_id` moves; no bytes are copied.

        Raises:
            FileExists, PathConflict: the new path is taken.
        """
        body = checked(FileUpdate, "The file", **changes)
        return self._api.patch(f"/files/{self.id_of(file_id)}", FileRead, body, etag=if_match)

    def label(
        self, file_ids: Iterable[Ref], *, add: Sequence[str] = (), remove: Sequence[str] = ()
    ) -> Iterator[FileLabelled]:
        """Add and remove labels of files; yield the outcome for each, in order. A refused one has a `problem`."""
        ids = [self.id_of(file_id) for file_id in file_ids]
        for start in range(0, len(ids), MAX_LABELLED):
            some = ids[start : start + MAX_LABELLED]
            body = checked(LabelChange, "The labels", file_ids=some, add=[*add], remove=[*remove])
            yield from self._api.repeat("/files/labels", FilesLabelled, body).items

    def delete(self, file_id: Ref, *, dry_run: bool = False) -> Deleted:
        """Move a file to the trash; with `dry_run`, only return what would go."""
        return self._to_trash(f"/files/{self.id_of(file_id)}", dry_run=dry_run)

    def verify(self, file_id: Ref) -> FileRead:
        """Have the server verify the stored bytes again; `state` and `verified_at` change when it has read them all.

        `kleinkram.client.transfer.verify_local` compares local files.
        """
        return self._api.repeat(f"/files/{self.id_of(file_id)}/verify", FileRead)

    def preview(self, file_id: Ref) -> "RecordingPreview":
        """Return what the preview of a recording shows: series, thumbnails, tracks, log lines and clouds.

        Reads at most 20 MB, whatever the size of the recording.

        Raises:
            PreviewMissing: there is none (yet); the sentence says why.
            PreviewUnreadable: it was made by a later server, or is damaged.
            ReadingExtraMissing: numpy is not installed.
            SourceError: the store does not give the bytes.
        """
        from kleinkram.recordings.http_source import HttpSource  # slow to import

        try:
            from kleinkram.recordings.previews import read_preview
        except ImportError as error:
            raise ReadingMissing(what=error.name or "numpy") from None
        read = self.preview_state(file_id)
        if read.url is None or read.size_bytes is None:
            raise PreviewMissing(path=str(read.file_id), reason=_why_no_preview(read))
        if read.size_bytes > _MAX_PREVIEW_BYTES:
            raise PreviewMissing(path=str(read.file_id), reason=f"it claims to have {read.size_bytes} bytes")
        source = HttpSource(
            read.url, size_bytes=read.size_bytes, name="the preview", connections=self._api.store_connections
        )
        return read_preview(source.read(0, read.size_bytes))

    def preview_state(self, file_id: Ref) -> RecordingPreviewRead:
        """Return whether the server has a preview of a recording, and its URL."""
        return self._api.get(f"/files/{self.id_of(file_id)}/preview", RecordingPreviewRead)

    def make_preview(self, file_id: Ref) -> RecordingPreviewRead:
        """Have the server make the preview of a recording again; this takes DELETE on its mission."""
        return self._api.repeat(f"/files/{self.id_of(file_id)}/preview", RecordingPreviewRead)

    def delete_preview(self, file_id: Ref) -> RecordingPreviewRead:
        """Delete the preview of a recording; the server makes it again on request only."""
        path = f"/files/{self.id_of(file_id)}/preview"
        return self._api.parse_response(RecordingPreviewRead, f"DELETE {path}", self._api.delete(path))

    def links(self, file_ids: Sequence[Ref]) -> DownloadLinks:
        """Return where to read the bytes of up to 500 files, in the order asked; FileUnavailable for a damaged one."""
        body = checked(DownloadRequest, "The files", file_ids=[self.id_of(file_id) for file_id in file_ids])
        return self._api.repeat("/files/download", DownloadLinks, body)


_PREVIEW_REASONS = {
    RecordingPreviewState.none: "the server has made none; it makes none of small files, and of what is no recording",
    RecordingPreviewState.making: "the server is about to make it",
    RecordingPreviewState.deleted: "it was deleted; `make_preview` makes it again",
}


def _why_no_preview(read: RecordingPreviewRead) -> str:
    return _PREVIEW_REASONS.get(read.state) or f"the server could not make it: {read.reason or 'the reason is unknown'}"


def file_label(file: FileRead) -> str:
    """Return a file as it is listed among candidates."""
    return f"{file.mission.project.name}/{file.mission.name}/{file.path} ({file.id})"


class Uploads(ApiResource):
    """`client.uploads`: the upload protocol, request by request; `kleinkram.client.transfer` uses it."""

    def now(self) -> datetime.datetime:
        """Return the time at the server, by which signed URLs expire."""
        return self._api.now()

    def list(self, mission_id: Ref) -> Listing[protocol.UploadRead]:
        """Yield the uploads into a mission that are under way."""
        return pages(self._api, f"/missions/{Missions(self._api).id_of(mission_id)}/uploads", protocol.UploadRead, [])

    def get(self, upload_id: uuid.UUID) -> protocol.UploadRead:
        """Return an upload with the parts that the store holds."""
        return self._api.get(f"/uploads/{upload_id}", protocol.UploadRead)

    def begin(self, mission_id: uuid.UUID, files: Sequence[protocol.UploadFile]) -> protocol.UploadDecisions:
        """Announce up to 200 files and return what to do with each, in the order given."""
        body = protocol.UploadBegin(files=[*files])
        return self._api.repeat(f"/missions/{mission_id}/uploads", protocol.UploadDecisions, body)

    def sign(self, parts: Sequence[protocol.PartToSign]) -> protocol.SignedParts:
        """Return where to PUT up to 200 parts, in the order given, and renew their leases; UploadGone if one ended."""
        body = protocol.PartsSign(parts=[*parts])
        return self._api.repeat("/uploads/parts", protocol.SignedParts, body)

    def complete(self, uploads: Sequence[protocol.UploadFinish]) -> protocol.UploadOutcomes:
        """Finish up to 200 uploads whose parts are all sent; the store verifies each. In the order given."""
        body = protocol.UploadsComplete(uploads=[*uploads])
        return self._api.repeat("/uploads/complete", protocol.UploadOutcomes, body)

    def abort(self, upload_id: uuid.UUID) -> None:
        """End an upload and free its name; its parts are removed."""
        self._api.delete(f"/uploads/{upload_id}")


class RemoteFiles:
    """The files of one recording as sources of bytes: presigned ranges, signed again when they expire.

    What `Recording.open` takes. Safe to share between threads.
    """

    def __init__(self, files: Files, file_ids: Sequence[uuid.UUID]) -> None:
        self._files = files
        self._file_ids = file_ids
        self._connections = files._api.store_connections

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the ids of the files, without connections and signed URLs."""
        return RemoteFiles, (self._files, self._file_ids)

    def sources(self) -> "Sequence[HttpSource]":
        """Return a source for each file, in the order given; FileUnavailable for a damaged one."""
        links: list[DownloadLink] = []
        for at in range(0, len(self._file_ids), _MAX_LINKS):
            links += self._files.links(self._file_ids[at : at + _MAX_LINKS]).items
        return [self._source(link) for link in links]

    def close(self) -> None:
        """Close the idle connections to the store; another recording that still needs them opens new ones."""
        self._connections.close()

    def _source(self, link: DownloadLink) -> "HttpSource":
        from kleinkram.recordings.http_source import HttpSource

        def sign_again() -> str:
            return self._files.links([link.file_id]).items[0].url

        def ask_for_check() -> None:
            with suppress(KleinkramError):  # without the right to ask, read on
                self._files.verify(link.file_id)

        return HttpSource(
            link.url,
            size_bytes=link.size_bytes,
            name=link.path,
            connections=self._connections,
            renew=sign_again,
            check=ask_for_check,
            sha256=link.sha256,
        )


class Recordings(ApiResource):
    """`client.recordings`."""

    def list(self, mission: Ref, *, project: Ref | None = None) -> Listing[RecordingRead]:
        """Yield the recordings of a mission."""
        mission_id = Missions(self._api).id_of(mission, project=project)
        return pages(self._api, f"/missions/{mission_id}/recordings", RecordingRead, [])

    def get(self, recording_id: str | uuid.UUID) -> RecordingRead:
        """Return one recording."""
        if (source := known_id(recording_id, "recording")) is None:
            raise InvalidInput(what=f"The recording {recording_id!r}", reason="give its id; `open` takes names")
        return self._api.get(f"/recordings/{source}", RecordingRead)

    def open(
        self,
        what: RecordingRead | FileRead | str | uuid.UUID,
        *,
        mission: Ref | None = None,
        project: Ref | None = None,
        max_bytes: int | None = None,
    ) -> "Recording":
        """Open a recording on the server for reading, as `recordings.Recording.open` does a local one.

        Only the needed ranges are fetched, straight from the store: the index when it is opened, then the chunks that
        are read. Use it in a `with`.

        Args:
            what: a recording, a file, the id of either; or the name of a recording in a mission, or a file's path.
            mission: the mission of a name or path.
            project: the project of the mission.
            max_bytes: a file without index is not read whole if it is larger than this; None: 1 GiB.

        Raises:
            TooCostly: a file would have to be read whole, and is larger than allowed.
            FileUnavailable: the store's copy is lost or corrupt.
            NotARecording: it holds no messages that can be read.
            SourceError: the store does not give the bytes.
        """
        from kleinkram.recordings import Recording  # slow to import

        source = self._find(what, mission, project)
        if isinstance(source, FileRead):
            ids = [source.id, *self._logs_of(source.mission.id, [source.path])]
        else:
            ids = [*self._metadata_of(source), *source.file_ids, *self._logs_of(source.mission.id, source.paths)]
        return Recording.open(RemoteFiles(Files(self._api), ids), max_bytes=max_bytes)

    def _find(
        self, what: RecordingRead | FileRead | str | uuid.UUID, mission: Ref | None, project: Ref | None
    ) -> RecordingRead | FileRead:
        if isinstance(what, RecordingRead | FileRead):
            return what
        if isinstance(what, uuid.UUID) or is_id(what):
            try:
                return self.get(what)
            except NotFound:
                return Files(self._api).get(what)
        if mission is not None:
            rows = self.list(Missions(self._api).get(mission, project=project).id)
            try:
                return resolve_one("recording", what, rows, name=lambda row: row.name, label=_recording_label)
            except NotFound:
                pass
        return Files(self._api).get(what, mission=mission, project=project)

    def _metadata_of(self, recording: RecordingRead) -> Sequence[uuid.UUID]:
        """Return the id of the metadata.yaml beside the members: it has what the data files lack."""
        if recording.kind != "rosbag2" or not recording.paths:
            return []
        folder = recording.paths[0].rpartition("/")[0]
        path = f"{folder}/{_METADATA}" if folder else _METADATA
        matching = FileFilter(mission_id=recording.mission.id, path=[path])
        return [file.id for file in Files(self._api).list(matching) if file.path == path]

    def _logs_of(self, mission_id: uuid.UUID, paths: Sequence[str]) -> Sequence[uuid.UUID]:
        """Return the ids of the logs and journals beside databases: they hold what a killed recorder wrote last."""
        log_paths = [f"{path}{suffix}" for path in paths if path.endswith(".db3") for suffix in ("-wal", "-journal")]
        if not log_paths:
            return []
        matching = FileFilter(mission_id=mission_id, path=log_paths)
        return [file.id for file in Files(self._api).list(matching) if file.path in log_paths and file.size_bytes]


def _recording_label(recording: RecordingRead) -> str:
    return f"{recording.name} ({recording.kind}, {recording.id})"
