"""A fake `python -m kleinkram.server` that starts in 50 ms, for tests of the supervisor.

`migrate` records its environment, `api` answers health checks, `worker` waits and starts a child of its own.
"""

import http.server
import json
import os
import signal
import ssl
import subprocess
import sys
from pathlib import Path


class _Health(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200 if self.path in ("/health/live", "/health/ready") else 404)
        self.end_headers()

    def do_POST(self) -> None:
        """Give the owner's link to who has the owner's token."""
        token = Path(os.environ["KLEINKRAM_OWNER_TOKEN_FILE"]).read_text().strip()
        known = self.headers["Authorization"] == f"Bearer {token}" and self.path == "/api/v1/auth/owner-link"
        self.send_response(200 if known else 403)
        self.end_headers()
        self.wfile.write(json.dumps({"url": "http://lab/sign-in/link#good-once"}).encode())

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  (the name it has in the base class)
        """Say nothing."""


def _serve(options: dict[str, str]) -> None:
    server = http.server.ThreadingHTTPServer((options["--host"], int(options["--port"])), _Health)
    if "--tls-cert" in options:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(options["--tls-cert"], options["--tls-key"])
        server.socket = context.wrap_socket(server.socket, server_side=True)
    server.serve_forever()


def _note_environment(name: str) -> None:
    environment = {key: value for key, value in os.environ.items() if key.startswith("KLEINKRAM_")}
    unfinished = Path(os.environ["KLEINKRAM_INSTANCE"], f"environment-{name}.json.new")
    unfinished.write_text(json.dumps(environment))
    unfinished.rename(unfinished.with_suffix(""))


def main() -> None:
    name, rest = sys.argv[1], sys.argv[2:]
    _note_environment(name)
    if name == "api":
        assert rest.pop(0) == "--wait-for-stdin"
        if sys.stdin.readline():
            _serve(dict(zip(rest[::2], rest[1::2], strict=True)))
    elif name == "worker":
        subprocess.Popen(["sleep", "1000"])
        signal.pause()


if __name__ == "__main__":
    main()
