"""The API on real PostgreSQL and a real S3 store, with direct access to its database for tests."""

import json
import secrets
import socket
import threading
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import psycopg
import urllib3
import uvicorn
from fastapi import FastAPI
from sqlalchemy import event

from kleinkram.server.app import create_app
from kleinkram.server.http.uvicorn_server import ApiServer
from kleinkram.server.settings import Settings
from tests.integration.openapi_check import assert_is_described

Query = Sequence[tuple[str, str]] | Mapping[str, str]


@dataclass(frozen=True)
class Answer:
    """A response of the API; `body` is the parsed JSON, the text of another content type, or None if it is empty."""

    status: int
    headers: Mapping[str, str]
    body: Any

    def ok(self, status: int = 200) -> Any:
        """Check the status of a successful response, and return its body."""
        assert self.status == status, f"{self.status}: {self.body}"
        return self.body

    def refused(self, status: int, code: str) -> Any:
        """Check that the response is this error, and return its problem document."""
        assert (self.status, self.body.get("code")) == (status, code), f"{self.status}: {self.body}"
        assert self.headers["content-type"] == "application/problem+json"
        return self.body


@dataclass
class Api:
    """A running API with its own database: requests with a token (initially of the owner), and direct SQL access.

    Attributes:
        at_end: what tests opened for it, to be closed before it ends.
    """

    url: str
    token: str | None
    app: FastAPI
    database: psycopg.Connection[tuple[Any, ...]]
    at_end: ExitStack = field(default_factory=ExitStack)
    _pool: urllib3.PoolManager = field(default_factory=lambda: urllib3.PoolManager(retries=False, timeout=30))

    def as_(self, token: str | None) -> "Api":
        """Return the same API with another token or link, or without a credential."""
        return replace(self, token=token)

    def call(
        self,
        method: str,
        path: str,
        body: object = None,
        query: Query = (),
        headers: Mapping[str, str] | None = None,
    ) -> Answer:
        """Send one request to `/api/v1{path}` with the token; `headers` are added and may replace it."""
        sent = {} if self.token is None else {"Authorization": f"Bearer {self.token}"}
        sent |= headers or {}
        data = None
        if body is not None:
            sent["Content-Type"] = "application/json"
            data = body if isinstance(body, bytes) else json.dumps(body).encode()
        pairs = list(query.items()) if isinstance(query, Mapping) else list(query)
        address = f"{self.url}/api/v1{path}" + (f"?{urlencode(pairs)}" if pairs else "")
        answer = self._pool.request(method, address, body=data, headers=sent)
        is_text = answer.headers.get("content-type", "").startswith(("text/", "application/jsonl"))
        parsed = answer.data.decode() if is_text else json.loads(answer.data) if answer.data else None
        result = Answer(answer.status, {name.lower(): value for name, value in answer.headers.items()}, parsed)
        assert_is_described(method, f"/api/v1{path}", result.status, result.body)
        return result

    def get(self, path: str, query: Query = ()) -> Answer:
        """GET."""
        return self.call("GET", path, query=query)

    def post(self, path: str, body: object = None) -> Answer:
        """POST."""
        return self.call("POST", path, body)

    def patch(self, path: str, body: object) -> Answer:
        """PATCH."""
        return self.call("PATCH", path, body)

    def delete(self, path: str, query: Query = ()) -> Answer:
        """DELETE."""
        return self.call("DELETE", path, query=query)

    def all(self, path: str, query: Mapping[str, str] | None = None) -> list[Any]:
        """Return the items of all pages of a list."""
        items: list[Any] = []
        cursor: dict[str, str] = {}
        while True:
            page = self.get(path, {**(query or {}), **cursor}).ok()
            items += page["items"]
            if page["next"] is None:
                return items
            cursor = {"cursor": page["next"]}

    def project(self, **fields: Any) -> Any:
        """Create a project, with a random name by default."""
        return self.post("/projects", {"name": f"project {uuid.uuid4().hex[:12]}", **fields}).ok(201)

    def mission(self, project_id: str, **fields: Any) -> Any:
        """Create a mission, with a random name by default."""
        body = {"name": f"mission {uuid.uuid4().hex[:12]}", **fields}
        return self.post(f"/projects/{project_id}/missions", body).ok(201)

    def sql(self, statement: str, *values: Any) -> list[tuple[Any, ...]]:
        """Run one statement directly in the database, and return its rows."""
        cursor = self.database.execute(statement, values)
        return cursor.fetchall() if cursor.description else []

    def metrics(self) -> str:
        """Return the metrics in the format of Prometheus."""
        return self._pool.request("GET", f"http://127.0.0.1:{self.app.state.metrics_port}/metrics").data.decode()

    def events(self, resource_id: str) -> list[Any]:
        """Return the audit events of a resource, latest first."""
        return self.all("/audit", {"resource_id": resource_id})

    @contextmanager
    def statements(self) -> Iterator[list[str]]:
        """Collect the SQL statements that the API runs inside the block."""
        engine = self.app.state.database.engine.sync_engine
        statements: list[str] = []

        def record(_connection: object, _cursor: object, statement: str, *_rest: object) -> None:
            statements.append(statement)

        event.listen(engine, "before_cursor_execute", record)
        try:
            yield statements
        finally:
            event.remove(engine, "before_cursor_execute", record)


@contextmanager
def serving(settings: Mapping[str, Any], *, admin_url: str, folder: Path, port: int = 0) -> Iterator[Api]:
    """Serve the API from a thread, by default on a free port."""
    token = secrets.token_hex(32)
    token_file = folder / f"token-{uuid.uuid4()}"
    token_file.write_text(token)
    app = create_app(Settings(**{"drain_s": 0, **settings}, owner_token_file=token_file))
    listener = socket.create_server(("127.0.0.1", port))
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=600,  # the tests' client does not repeat a request whose connection was idle and just closed
    )
    server = ApiServer(config, app)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="api")
    thread.start()
    database = psycopg.connect(admin_url, autocommit=True)
    try:
        deadline = time.monotonic() + 30
        while not server.started:
            assert thread.is_alive(), "the API did not start; the log says why"
            assert time.monotonic() < deadline, "the API took too long to start"
            thread.join(0.01)
        with ExitStack() as at_end:
            yield Api(f"http://127.0.0.1:{listener.getsockname()[1]}", token, app, database, at_end)
    finally:
        server.should_exit = True
        thread.join(20)
        listener.close()
        database.close()
