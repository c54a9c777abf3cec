"""Recordings, for programs: logical captures made of one or more files."""

import uuid
from collections.abc import Iterator

from kleinkram.client._http import Api
from kleinkram.client._paging import pages
from kleinkram.contract.files import RecordingRead


class Recordings:
    """`client.recordings`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(self, mission_id: uuid.UUID) -> Iterator[RecordingRead]:
        """Yield the recordings of a mission."""
        return pages(self._api, f"/missions/{mission_id}/recordings", RecordingRead, [])

    def get(self, recording_id: str | uuid.UUID) -> RecordingRead:
        """Return one recording.

        Raises:
            NotFound: there is none with this id.
        """
        return self._api.get(f"/recordings/{recording_id}", RecordingRead)
