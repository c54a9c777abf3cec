"""Recordings, for programs: logical captures made of one or more files, listed, and read where they are."""

import uuid
from collections.abc import Sequence
from typing import TYPE_CHECKING

from kleinkram.client._http import Api
from kleinkram.client._nouns import Listing, Ref, known_id, pages, resolve_one
from kleinkram.client.errors import InvalidInput
from kleinkram.client.files import Files
from kleinkram.client.missions import Missions
from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import FileFilter, FileRead, RecordingRead
from kleinkram.contract.names import is_id

if TYPE_CHECKING:
    from kleinkram.recordings import Recording

_METADATA = "metadata.yaml"


class Recordings:
    """`client.recordings`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(self, mission: Ref, *, project: Ref | None = None) -> Listing[RecordingRead]:
        """Yield the recordings of a mission."""
        mission_id = Missions(self._api).id_of(mission, project=project)
        return pages(self._api, f"/missions/{mission_id}/recordings", RecordingRead, [])

    def get(self, recording_id: str | uuid.UUID) -> RecordingRead:
        """Return one recording.

        Raises:
            NotFound: there is none with this id.
        """
        if (source := known_id(recording_id, "recording")) is None:
            raise InvalidInput(what=f"The recording {recording_id!r}", reason="give its id; `open` takes names")
        return self._api.get(f"/recordings/{source}", RecordingRead)

    def open(
        self,
        what: RecordingRead | FileRead | str | uuid.UUID,
        *,
        mission: Ref | None = None,
        project: Ref | None = None,
        most_bytes: int | None = None,
    ) -> "Recording":
        """Open a recording on the server for reading, as `recordings.reading.Recording.open` does a local one.

        Only what is asked for is fetched, straight from the store: the index when it is opened, then the chunks that
        hold what is wanted. Use it in a `with`.

        Args:
            what: a recording, a file, the id of either; or the name of a recording in a mission, or a file's path.
            mission: where a name or path is looked for.
            project: of the mission.
            most_bytes: a file without index is not read whole if it has more bytes than this; None: 1 GiB.

        Raises:
            NotFound: there is no such recording or file.
            TooCostly: a file would have to be read whole, and has more bytes than are allowed.
            AmbiguousName: several missions have a file of that path.
            FileUnavailable: the store's copy is lost or corrupt.
            NotARecording: it holds no messages that are read.
            SourceError: the store does not give the bytes.
        """
        from kleinkram.client._remote import RemoteFiles
        from kleinkram.recordings import Recording  # only who reads pays for importing it

        source = self._find(what, mission, project)
        if isinstance(source, FileRead):
            ids = [source.id, *self._logs_of(source.mission.id, [source.path])]
        else:
            ids = [*self._metadata_of(source), *source.file_ids, *self._logs_of(source.mission.id, source.paths)]
        return Recording.open(RemoteFiles(Files(self._api), ids), most_bytes=most_bytes)

    def _find(
        self,
        what: RecordingRead | FileRead | str | uuid.UUID,
        mission: Ref | None,
        project: Ref | None,
    ) -> RecordingRead | FileRead:
        if isinstance(what, RecordingRead | FileRead):
            return what
        if isinstance(what, uuid.UUID) or is_id(what):
            try:
                return self.get(what)
            except NotFound:
                return Files(self._api).get(what)
        if mission is not None:
            named = self.list(Missions(self._api).get(mission, project=project).id)
            try:
                return resolve_one("recording", what, named, name=lambda row: row.name, label=_label)
            except NotFound:
                pass
        return Files(self._api).get(what, mission=mission, project=project)

    def _metadata_of(self, recording: RecordingRead) -> Sequence[uuid.UUID]:
        """Return the id of the metadata.yaml beside the members: it says what the data files do not."""
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
