"""The one door to the object store: PUT and GET of signed URLs, with what each answer means.

Knows nothing of uploads or files. One pool of connections, shared by the threads of a transfer.
"""

import enum
import http.client
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import urllib3

from kleinkram.client._http import reason_of
from kleinkram.client._retry import Backoff
from kleinkram.client.transfer._connections import Connections
from kleinkram.client.transfer._source import FileSlice

PATIENCE_S = 240.0
# Of files that the store gave trouble with for so long, one after the other: then it is in trouble itself.
MOST_TROUBLED = 3
_WORTH_SAYING_S = 5.0

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

    `is_of_all`: others would meet the same.
    """

    answer: Answer
    etag: str = ""
    reason: str = ""
    error: BaseException | None = None
    is_of_all: bool = False

    @property
    def why(self) -> str:
        """Why it was not taken, in words."""
        return reason_of(self.error) if self.error else self.reason


class Trouble:
    """Says, once in a transfer, that the store keeps it waiting, and why. Shared by the threads of the transfer."""

    def __init__(self, said: Callable[[str], None]) -> None:
        self._said = said
        self._is_said = False
        self._lock = threading.Lock()

    def note(self, backoff: Backoff, reason: str) -> None:
        """Hear of one more failed try; what passes by itself in seconds is not worth a word."""
        if backoff.lasting_s() < _WORTH_SAYING_S:
            return
        with self._lock:
            first, self._is_said = not self._is_said, True
        if first:
            self._said(
                f"waiting for the store, which is away or full ({reason}): goes on by itself if that ends within "
                f"{PATIENCE_S / 60:.0f} minutes; `klein doctor` on the server's machine says what is wrong"
            )


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
        """Yield the bytes.

        Raises:
            urllib3.exceptions.HTTPError: the connection ended early.
        """
        if self._response is not None:
            yield from self._response.stream(self._slice_bytes, decode_content=False)
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
