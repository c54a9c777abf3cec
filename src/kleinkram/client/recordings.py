"""Recordings: captures made of one or more files, listed, and read from the store in ranges."""

import uuid
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from kleinkram.client._nouns import ApiResource, Listing, Ref, known_id, pages, resolve_one
from kleinkram.client.errors import InvalidInput
from kleinkram.client.files import Files
from kleinkram.client.missions import Missions
from kleinkram.contract.errors import KleinkramError, NotFound
from kleinkram.contract.files import DownloadLink, FileFilter, FileRead, RecordingRead
from kleinkram.contract.names import is_id

if TYPE_CHECKING:
    from kleinkram.recordings import Recording
    from kleinkram.recordings.http_source import HttpSource

_METADATA = "metadata.yaml"
_MAX_LINKS = 500


class RemoteFiles:
    """The files of one recording as sources of bytes: presigned ranges, signed again when they expire.

    What `Recording.open` takes. Safe to share between threads.
    """

    def __init__(self, files: Files, file_ids: Sequence[uuid.UUID]) -> None:
        from kleinkram.recordings.http_source import HttpConnections  # only reading needs it
        from kleinkram.recordings.limits import PARALLEL_READS

        self._files = files
        self._file_ids = file_ids
        self._connections = HttpConnections(PARALLEL_READS)

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
        """Close the connections to the store."""
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
                return resolve_one("recording", what, rows, name=lambda row: row.name, label=_label)
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


def _label(recording: RecordingRead) -> str:
    return f"{recording.name} ({recording.kind}, {recording.id})"
