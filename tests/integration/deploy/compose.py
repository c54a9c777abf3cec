"""The Compose project of `deploy/compose`, in a folder of its own, on a Docker daemon for tests."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import urllib3

from tests.certificate import make_certificate
from tests.integration.deploy import images
from tests.integration.deploy.images import ROOT
from tests.integration.runner.engines import Dockerd
from tests.ports import choose_port
from tests.requirements import need_compose

# Of this process: another session may have a project at the same time.
NETWORK = f"10.199.{os.getpid() % 256}"


@dataclass(frozen=True)
class Project:
    """A Compose project. `folder` is a copy of `deploy/compose`."""

    folder: Path
    docker: Dockerd
    url: str
    pool: urllib3.PoolManager

    @property
    def certificate(self) -> Path:
        """The certificate that clients trust."""
        return self.folder / "tls" / "cert.pem"

    def compose(self, *words: str, check: bool = True) -> str:
        """Run `docker compose` in the folder; return what it prints."""
        socket = f"unix://{self.docker.socket}"
        environment = {"PATH": os.environ["PATH"], "HOME": str(self.folder), "DOCKER_HOST": socket}
        command = [need_compose(), *words]
        done = subprocess.run(
            command, cwd=self.folder, env=environment, capture_output=True, text=True, check=False, timeout=280
        )
        assert not check or done.returncode == 0, f"{words}: {done.stdout[-2000:]}{done.stderr[-4000:]}\n{self.logs()}"
        return done.stdout

    def logs(self, *services: str) -> str:
        """Return the last lines of the logs of services."""
        return self.compose("logs", "--no-color", "--tail", "60", *services, check=False)

    def inspect(self, service: str) -> Any:
        """Return Docker's description of the container of a service."""
        container = self.compose("ps", "--all", "--quiet", service).strip()
        return json.loads(self.docker.docker("inspect", container))[0]

    def change(self, **variables: str) -> None:
        """Change variables in `.env`."""
        path = self.folder / ".env"
        text = path.read_text()
        for name, value in variables.items():
            assert re.search(f"^{name}=", text, re.MULTILINE), f"{path} has no {name}"
            text = re.sub(f"^{name}=.*$", f"{name}={value}", text, flags=re.MULTILINE)
        path.write_text(text)

    def request(self, method: str, path: str, body: object = None, headers: Mapping[str, str] | None = None) -> Any:
        """Send a request to the API through the proxy; return the response."""
        sent = {"Origin": self.url, "Content-Type": "application/json", **(headers or {})}
        data = None if body is None else json.dumps(body).encode()
        return self.pool.request(method, self.url + path, body=data, headers=sent)

    def klein(self, token: str, *words: object) -> str:
        """Run a `klein` command of a person; return what it prints."""
        environment = {
            "PATH": os.environ["PATH"],
            "PYTHONPATH": str(ROOT / "src"),
            "HOME": str(self.folder),
            "KLEINKRAM_URL": self.url,
            "KLEINKRAM_TOKEN": token,
            "SSL_CERT_FILE": str(self.certificate),
        }
        program = [sys.executable, "-c", "from kleinkram.cli.main import main; main()"]
        done = subprocess.run(
            [*program, *map(str, words)], env=environment, capture_output=True, text=True, check=False, timeout=280
        )
        assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}\n{self.logs()}"
        return done.stdout


def prepare(folder: Path) -> Path:
    """Copy what a machine needs of `deploy` into a folder; return the folder of the project."""
    written_by_init = (ROOT / "deploy" / "compose" / ".gitignore").read_text().split()
    ignored = shutil.ignore_patterns(*(Path(name).name for name in written_by_init))
    for name in ("caddy", "observability"):
        shutil.copytree(ROOT / "deploy" / name, folder / name)
    return Path(shutil.copytree(ROOT / "deploy" / "compose", folder / "compose", ignore=ignored))


def initialise(folder: Path, name: str) -> str:
    """Run `./init`; return what it prints."""
    return subprocess.run([folder / "init", name], check=True, capture_output=True, text=True).stdout


@contextmanager
def project(docker: Dockerd, parent: Path) -> Iterator[Project]:
    """A project that is not started yet, with the images of tests and a certificate of its own."""
    folder = prepare(parent)
    # A name: without one in the TLS handshake, Caddy looks for a certificate of its address in the container.
    initialise(folder, "localhost")
    certificate, key = make_certificate(folder / "tls", "localhost")
    port = choose_port()
    pool = urllib3.PoolManager(ca_certs=str(certificate), retries=False, timeout=30)
    one = Project(folder, docker, f"https://localhost:{port}", pool)
    one.change(
        PUBLIC_URL=one.url,
        TLS=f"tls /etc/caddy/tls/{certificate.name} /etc/caddy/tls/{key.name}",
        HTTP_PORT=f"127.0.0.1:{choose_port()}",
        HTTPS_PORT=f"127.0.0.1:{port}",
        SERVER_IMAGE=images.SERVER,
        POSTGRES_IMAGE=images.POSTGRES,
        STORE_IMAGE=images.STORE,
        PROXY_IMAGE=images.PROXY,
        SUBNET=f"{NETWORK}.0/24",
        **{f"{name.upper()}_IMAGE": images.monitor_image(name) for name in images.MONITORS},
    )
    try:
        yield one
    finally:
        one.compose("down", "--volumes", "--timeout", "5", check=False)
