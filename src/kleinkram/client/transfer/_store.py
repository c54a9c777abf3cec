"""The one door to the object store: PUT and GET of signed URLs, with what each answer means.

Knows nothing of uploads or files. One pool of connections, shared by the threads of a transfer.
"""

import enum
import http.client
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import urllib3

from kleinkram.client._http import reason_of
from kleinkram.client.transfer._connections import Connections
from kleinkram.client.transfer._source import FileSlice

PATIENCE_S = 240.0
# Of files that the store gave trouble with for so long, one after the other: then it is in trouble itself.
MOST_TROUBLED = 3

_LEAST_SLICE_BYTES = 64 * 1024
_QUICK_SLICE_S = 0.5

_GONE = frozenset({"NoSuchUpload", "NoSuchKey"})
# What is no word about one object: of the store as a whole, where all others would meet the same.
_OF_ALL = frozenset({"", "ServiceUnavailable", "SlowDown", "XMinioStorageFull"})
# Never well, however often it is tried.
_NEVER = frozenset({501, 505})
_CODE = re.compile(rb"<Code>([A-Za-z]{1,64})</Code>")


class Answer(enum.Enum):
    """What the store's answer means for whoever asked."""

    taken = enum.auto()
    try_again = enum.auto()
    sign_again = enum.auto()
    gone = enum.auto()
    refused = enum.auto()


@dataclass(frozen=True)
class PutAnswer:
    """What became of a PUT: the etag when taken, else the store's word for why not.

    `is_of_all`: others would meet the same. `sent_bytes`: how much of the body was given to the network.
    """

    answer: Answer
    etag: str = ""
    reason: str = ""
    error: BaseException | None = None
    is_of_all: bool = False
    sent_bytes: int = 0

    @property
    def why(self) -> str:
        """Why it was not taken, in words."""
        return reason_of(self.error) if self.error else self.reason


class StoreDoor:
    """Connections to the store."""

    def __init__(self, connections: int) -> None:
        self._connections = Connections(connections)

    def close(self) -> None:
        """Close the connections."""
        self._connections.clear()

    def put(
        self, url: str, headers: Mapping[str, str], size_bytes: int, body: Iterable[FileSlice | bytes]
    ) -> PutAnswer:
        """PUT so many bytes, sent as they come from `body`."""
        headers = {**headers, "Content-Length": str(size_bytes)}
        try:
            reply = self._connections.put(url, headers, body)
        except (urllib3.exceptions.HTTPError, http.client.HTTPException, OSError) as error:
            return PutAnswer(Answer.try_again, error=error, is_of_all=True)
        # 412: written already, by an earlier try whose answer was lost; the address was signed for these bytes only.
        if reply.status < 300 or reply.status == 412:
            return PutAnswer(Answer.taken, etag=reply.etag.strip('"'))
        code = _code(reply.content)
        said = _reason(reply.status, code)
        return PutAnswer(meaning(reply.status, code), reason=said, is_of_all=code in _OF_ALL)

    def get(self, url: str, first: int, last: int, slice_bytes: int) -> "GetAnswer":
        """GET the bytes first..last, both inclusive; the answer must be closed."""
        headers = {"Range": f"bytes={first}-{last}", "Accept-Encoding": "identity"}
        try:
            answer = self._connections.request(
                "GET", url, headers=headers, redirect=False, preload_content=False, decode_content=False
            )
        except urllib3.exceptions.HTTPError as error:
            return GetAnswer(Answer.try_again, None, slice_bytes, error=error)
        whole = answer.status == 200 and first == 0
        if answer.status == 206 or whole:
            return GetAnswer(Answer.taken, answer, slice_bytes)
        code = _code(answer.read(2000))
        answer.close()
        reason = _reason(answer.status, code)
        return GetAnswer(meaning(answer.status, code), None, slice_bytes, reason=reason, is_of_all=code in _OF_ALL)


class GetAnswer:
    """The answer to a GET: its meaning, and its bytes when the store gives them."""

    def __init__(
        self,
        answer: Answer,
        response: urllib3.BaseHTTPResponse | None,
        slice_bytes: int,
        *,
        reason: str = "",
        error: BaseException | None = None,
        is_of_all: bool = False,
    ) -> None:
        self.answer = answer
        self.reason = reason
        self.error = error
        self._is_of_all = is_of_all
        self._response = response
        self._slice_bytes = slice_bytes

    @property
    def why(self) -> str:
        """Why it gave nothing, or not all, in words."""
        return reason_of(self.error) if self.error else self.reason or "it sends nothing"

    @property
    def is_of_all(self) -> bool:
        """Whether others would meet the same, as nobody answers or not for any object."""
        return self.error is not None or (self.answer is Answer.try_again and self._is_of_all)

    def slices(self) -> Iterator[bytes]:
        """Yield the bytes: in small slices from a slow link, since what has come of a slice is lost with a connection.

        Raises:
            urllib3.exceptions.HTTPError: the connection ended early.
        """
        if self._response is None:
            return
        slice_bytes = least_bytes = min(_LEAST_SLICE_BYTES, self._slice_bytes)
        began_at = time.monotonic()
        while data := self._response.read(slice_bytes, decode_content=False):
            is_quick = time.monotonic() - began_at < _QUICK_SLICE_S
            slice_bytes = min(2 * slice_bytes, self._slice_bytes) if is_quick else max(slice_bytes // 2, least_bytes)
            yield data
            began_at = time.monotonic()
        self._response.release_conn()

    def close(self) -> None:
        """Drop what has not been read."""
        if self._response is not None:
            self._response.close()


def meaning(status: int, code: str) -> Answer:
    """Return what a status other than success means, with the store's code for it ("" where it gave none)."""
    if code in _GONE:
        return Answer.gone
    if status == 403:
        return Answer.sign_again
    # 404 without the store's own word is that of a proxy which does not reach the store.
    if status in {404, 408, 410, 429} or (status >= 500 and status not in _NEVER) or code == "RequestTimeout":
        return Answer.try_again
    return Answer.refused


def _code(body: bytes) -> str:
    found = _CODE.search(body)
    return found.group(1).decode() if found else ""


def _reason(status: int, code: str) -> str:
    return f"the store answered {status} {code}".rstrip()
