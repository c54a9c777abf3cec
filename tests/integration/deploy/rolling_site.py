"""A server behind a proxy of `deploy/`: API processes and workers, each a real process, of any version."""

import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psycopg
import urllib3

import kleinkram
from tests.certificate import make_certificate
from tests.integration.deploy.proxies import caddy_command, nginx_command, run
from tests.integration.upload_client import wait_until
from tests.ports import choose_port

SOURCE = Path(kleinkram.__file__).parents[1]
START_S = 120


@dataclass
class Site:
    """The machine of a server: its settings, programs of two versions, and what runs."""

    folder: Path
    settings: dict[str, str]
    ports: dict[str, int]
    stack: ExitStack
    processes: dict[str, "subprocess.Popen[bytes]"] = field(default_factory=dict)

    def environment(self, source: Path) -> dict[str, str]:
        names = ("PATH", "LANG", "HOME")
        inherited = {name: os.environ[name] for name in names if name in os.environ}
        return {**inherited, **self.settings, "PYTHONPATH": str(source)}

    def run(self, source: Path, *arguments: str) -> str:
        command = [sys.executable, "-m", "kleinkram.server", *arguments]
        environment = self.environment(source)
        done = subprocess.run(command, env=environment, cwd=self.folder, check=False, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stderr

    def start(self, name: str, source: Path, *arguments: str) -> None:
        """Start an API process (`api1`, `api2`) or worker, and wait until it is ready."""
        command = [sys.executable, "-m", "kleinkram.server", *arguments]
        if name.startswith("api"):
            command += ["--host", "127.0.0.1", "--port", str(self.ports[name])]
        with (self.folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(command, env=self.environment(source), cwd=self.folder, stdout=log, stderr=log)
        self.processes[name] = process
        self.stack.callback(process.kill)
        if name.startswith("api"):
            wait_until(lambda: self.is_ready(name), limit_s=START_S)

    def stop(self, name: str) -> None:
        """Stop a process as systemd does, and wait until it has finished its requests or jobs."""
        process = self.processes.pop(name)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) in {0, -signal.SIGTERM}, (self.folder / f"{name}.log").read_text()[-3000:]

    def is_ready(self, name: str) -> bool:
        assert self.processes[name].poll() is None, (self.folder / f"{name}.log").read_text()[-3000:]
        try:
            return (
                urllib3.request("GET", f"http://127.0.0.1:{self.ports[name]}/health/ready", retries=False).status == 200
            )
        except urllib3.exceptions.HTTPError:
            return False

    def sql(self, statement: str) -> list[tuple[Any, ...]]:
        with psycopg.connect(self.settings["KLEINKRAM_DATABASE_URL"]) as connection:
            return connection.execute(statement).fetchall()

    def worker_versions(self) -> set[str]:
        alive = "SELECT version FROM worker_process WHERE ended_at IS NULL AND seen_at > now() - interval '15 s'"
        return {str(row[0]) for row in self.sql(alive)}


@contextmanager
def proxied_site(folder: Path, settings: dict[str, str], *, store: str, proxy: str) -> Iterator[Site]:
    """Serve a database and a bucket behind nginx or Caddy, with TLS; `store` is the address of the store."""
    ports = {name: choose_port() for name in ("api1", "api2", "http", "https")}
    certificate, key = make_certificate(folder, "127.0.0.1")
    url = f"https://127.0.0.1:{ports['https']}"
    settings = {
        **settings,
        "KLEINKRAM_S3_INTERNAL_URL": store,
        "KLEINKRAM_S3_PUBLIC_URL": url,
        "KLEINKRAM_PUBLIC_URL": url,
        "KLEINKRAM_TRUSTED_PROXIES": "127.0.0.1",
        "KLEINKRAM_OWNER_TOKEN_FILE": str(folder / "owner-token"),
        **{f"KLEINKRAM_{kind}_PER_MINUTE": "0" for kind in ("UPLOADS", "DOWNLOADS")},
    }
    (folder / "owner-token").write_text(secrets.token_hex(32))
    changes = {
        "127.0.0.1:8000": f"127.0.0.1:{ports['api1']}",
        "127.0.0.1:8001": f"127.0.0.1:{ports['api2']}",
        "127.0.0.1:9000": store.removeprefix("http://"),
        "/kleinkram/": f"/{settings['KLEINKRAM_S3_BUCKET']}/",
        "/etc/ssl/kleinkram.pem": str(certificate),
        "/etc/ssl/kleinkram.key": str(key),
    }
    own = folder / "proxy"
    own.mkdir()
    with ExitStack() as stack:
        process = run((nginx_command if proxy == "nginx" else caddy_command)(own, changes, ports), own)
        stack.callback(process.wait, 30)
        stack.callback(process.terminate)
        yield Site(folder, settings, ports, stack)
