"""The HTTP interface of the fake API server."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING

from tests.http_server import PersistentHandler

if TYPE_CHECKING:
    from tests.integration.kubernetes.fake_cluster import FakeCluster


class ApiHandler(PersistentHandler):
    """One connection to the cluster `fake`."""

    fake: FakeCluster

    def do_GET(self) -> None:
        self._do("GET")

    def do_POST(self) -> None:
        self._do("POST")

    def do_DELETE(self) -> None:
        self._do("DELETE")

    def _do(self, method: str) -> None:
        from tests.integration.kubernetes.fake_cluster import Refused

        body = self.body()
        if self.fake.is_away.is_set():
            self.close_connection = True
            return
        try:
            answer = self.fake.answer(method, self.path, body, self.headers["Authorization"])
        except Refused as error:
            status = {
                "kind": "Status",
                "status": "Failure",
                "message": str(error),
                "reason": error.reason,
                "code": error.code,
            }
            self._say(error.code, json.dumps(status).encode())
            return
        if isinstance(answer, dict):
            self._say(201 if method == "POST" else 200, json.dumps(answer).encode())
        else:
            self._stream(answer)

    def _say(self, status: int, body: bytes) -> None:
        self.send(status, body, {"Content-Type": "application/json"})

    def _stream(self, pieces: Iterator[bytes]) -> None:
        self.send_response(200)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        self.wfile.flush()
        for piece in pieces:
            if piece:
                self.wfile.write(f"{len(piece):x}\r\n".encode() + piece + b"\r\n")
                self.wfile.flush()
        self.wfile.write(b"0\r\n\r\n")
