"""The HTTP interface of the fake server and its store, with adjustable delays and failures."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING

from kleinkram.contract.errors import KleinkramError, NotAuthenticated
from kleinkram.contract.problems import to_problem
from tests.http_server import PersistentHandler

if TYPE_CHECKING:
    from tests.integration.runner_loop.fake_server import FakeServer

RUN_TOKEN = "klein_run_" + "t" * 43 + "abcdef"
RUNNER_TOKEN = "klein_runner_" + "r" * 43 + "012345"


class Handler(PersistentHandler):
    """One connection to the stand-in `fake`."""

    fake: FakeServer

    def do_GET(self) -> None:
        self._do("GET")

    def do_POST(self) -> None:
        self._do("POST")

    def do_PUT(self) -> None:
        body = self.body()
        path, _, query = self.path.partition("?")
        is_taken = self.fake.write(path.removeprefix("/store/"), body, query.removeprefix("sha256="))
        self.send(200 if is_taken else 503, b"" if is_taken else self.fake.store_says, {"ETag": '"e"'})

    def _do(self, method: str) -> None:
        body = self.body()
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
            self.send(error.status, problem, {"Content-Type": "application/problem+json"})
            return
        if self.fake.is_silent.is_set():
            self.close_connection = True
            return
        self.send(200 if answer else 204, answer.model_dump_json().encode() if answer else b"")

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
