"""Files on the server as sources of bytes: presigned ranges, with new addresses when the old ones have run out."""

import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from kleinkram.client.files import Files
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.files import DownloadLink
from kleinkram.recordings.http_source import HttpConnections, HttpSource
from kleinkram.recordings.limits import PARALLEL_READS

_MOST_FILES = 500


class RemoteFiles:
    """The files of one recording, what `Recording.open` takes. Safe to share between threads."""

    def __init__(self, files: Files, file_ids: Sequence[uuid.UUID]) -> None:
        self._files = files
        self._file_ids = file_ids
        self._connections = HttpConnections(PARALLEL_READS)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle which files they are, without connections and addresses: both are made anew."""
        return RemoteFiles, (self._files, self._file_ids)

    def sources(self) -> Sequence[HttpSource]:
        """Return a source for each file, in the order given.

        Raises:
            FileUnavailable: the store's copy of one is lost or corrupt.
        """
        links: list[DownloadLink] = []
        for at in range(0, len(self._file_ids), _MOST_FILES):
            links += self._files.links(self._file_ids[at : at + _MOST_FILES]).items
        return [self._source(link) for link in links]

    def close(self) -> None:
        """Close the connections to the store."""
        self._connections.close()

    def _source(self, link: DownloadLink) -> HttpSource:
        renew: Callable[[], str] = partial(self._sign_again, link.file_id)
        return HttpSource(
            link.url,
            size_bytes=link.size_bytes,
            name=link.path,
            connections=self._connections,
            renew=renew,
            check=partial(self._ask_for_check, link.file_id),
        )

    def _ask_for_check(self, file_id: uuid.UUID) -> None:
        with suppress(KleinkramError):  # who may not ask for it reads on
            self._files.verify(file_id)

    def _sign_again(self, file_id: uuid.UUID) -> str:
        return self._files.links([file_id]).items[0].url
