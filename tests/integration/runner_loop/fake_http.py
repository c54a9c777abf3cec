"""The HTTP interface of the fake server and its store, with adjustable delays and failures."""

from __future__ import annotations

import re
import time
from http.server import BaseHTTPRequestHandler
from typing import TYPE_CHECKING, Any

from kleinkram.contract.errors import KleinkramError, NotAuthenticated
from kleinkram.contract.problems import to_problem

if TYPE_CHECKING:
    from tests.integration.runner_loop.fake_server import FakeServer

RUN_TOKEN = "klein_run_" + "t" * 43 + "abcdef"
RUNNER_TOKEN = "klein_runner_" + "r" * 43 + "012345"


class Handler(BaseHTTPRequestHandler):
    """One connection to the stand-in `fake`."""

    fake: FakeServer
    protocol_version = "HTTP/1.1"
    # An answer is two writes; else each waits for the other side's word.
    disable_nagle_algorithm = True
    wbufsize = -1

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  as its base calls it
        """Say nothing."""

    def do_GET(self) -> None:
        self._do("GET")

    def do_POST(self) -> None:
        self._do("POST")

    def do_PUT(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        path, _, query = self.path.partition("?")
        is_taken = self.fake.write(path.removeprefix("/store/"), body, query.removeprefix("sha256="))
        self._say(200 if is_taken else 503, b"" if is_taken else self.fake.store_says, {"ETag": '"e"'})

    def _do(self, method: str) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        path, _, query = self.path.partition("?")
        if self.fake.is_silent.is_set():
            self.close_connection = True
            return
        if path.startswith("/store/"):
            self._give(self.fake.read(path.removeprefix("/store/")))
            return
        allowed = {RUNNER_TOKEN, RUN_TOKEN} if path == "/api/v1/service" else {RUNNER_TOKEN}
        try:
            if self.headers["Authorization"] not in {f"Bearer {token}" for token in allowed}:
                raise NotAuthenticated(reason="the token is not valid")
            answer = self.fake.answer(method, path.removeprefix("/api/v1"), query, body)
        except KleinkramError as error:
            problem = to_problem(error, "a-request").model_dump_json().encode()
            self._say(error.status, problem, {"Content-Type": "application/problem+json"})
            return
        if self.fake.is_silent.is_set():
            self.close_connection = True
            return
        self._say(200 if answer else 204, answer.model_dump_json().encode() if answer else b"", {})

    def _give(self, data: bytes) -> None:
        expected = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers["Range"])
        assert expected is not None
        data = data[int(expected.group(1)) : int(expected.group(2)) + 1]
        self.send_response(206)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        pace = self.fake.slow_bytes_per_s
        step = len(data) if pace is None else max(1, int(pace / 20))
        try:
            for at in range(0, len(data), step or 1):
                self.wfile.write(data[at : at + step])
                if pace is not None:
                    self.wfile.flush()
                    time.sleep(0.05)
        except OSError:
            self.close_connection = True

    def _say(self, status: int, body: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)
