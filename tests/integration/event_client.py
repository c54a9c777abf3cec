"""A client of the event stream that does not reconnect."""

import http.client
import json
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlencode, urlsplit

from tests.integration.api_server import Api

_PATIENCE_S = 60.0


class Ears:
    """The events that one stream has received so far."""

    def __init__(self, answer: http.client.HTTPResponse) -> None:
        self.events: list[tuple[str, Any]] = []
        self.comments = 0
        self.last_id = ""
        self.is_over = False
        self._answer = answer
        self._changed = threading.Condition()
        self.thread = threading.Thread(target=self._listen, name="ears", daemon=True)
        self.thread.start()

    def receive(self, **fields: object) -> Any:
        """Wait for a change with these values, and return it."""

        def met() -> list[Any]:
            return [data for _, data in self.events if fields.items() <= data.items()]

        self.until(lambda: bool(met()), f"{fields}")
        return met()[0]

    def until(self, holds: Callable[[], bool], what: str = "") -> None:
        """Wait until a condition on the received events holds."""
        with self._changed:
            assert self._changed.wait_for(holds, _PATIENCE_S), f"{what} not heard; but {self.events}"

    def ends(self) -> None:
        """Wait until the stream ends."""
        self.until(lambda: self.is_over, "the end was")

    def _listen(self) -> None:
        event = ""
        try:
            while line := self._answer.readline():
                event = self._read(line.decode().rstrip(), event)
        except (http.client.HTTPException, OSError):  # broken off; by the test, maybe
            pass
        with self._changed:
            self.is_over = True
            self._changed.notify_all()

    def _read(self, line: str, event: str) -> str:
        name, _, value = line.partition(": ")
        with self._changed:
            if line.startswith(":"):
                self.comments += 1
            elif name == "id":
                self.last_id = value
            elif name == "data":
                self.events.append((event, json.loads(value)))
            self._changed.notify_all()
        return value if name == "event" else event


@contextmanager
def listening(api: Api, *, headers: Mapping[str, str] | None = None, **query: str) -> Iterator[Ears]:
    """Listen as the carrier of the API's token, unless headers say otherwise; from before it returns."""
    sent = {"Authorization": f"Bearer {api.token}"} if headers is None else headers
    connection = http.client.HTTPConnection(urlsplit(api.url).netloc, timeout=40)
    connection.request("GET", f"/api/v1/events?{urlencode(query)}", headers=dict(sent))
    # An answer may take its connection over, which then forgets the socket.
    line = connection.sock
    answer = connection.getresponse()
    assert answer.status == 200, answer.read()
    assert str(answer.getheader("Content-Type")).startswith("text/event-stream")
    ears = Ears(answer)
    try:
        ears.until(lambda: ears.last_id != "", "the beginning")
        yield ears
    finally:
        if not ears.is_over:
            line.shutdown(socket.SHUT_RDWR)
        ears.thread.join(10)
        connection.close()
