"""Client for the Docker Engine API over a Unix socket, which Podman serves as well.

Every call uses its own connection, so threads may share a client.
"""

import base64
import json
import os
import shutil
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from io import BufferedReader
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, urlencode

from kleinkram.runner.images.names import ImageName, parse_image_name

_TIMEOUT_S = 60.0
# Engines themselves give up sooner on a registry that does not answer.
_PULL_TIMEOUT_S = 300.0
# The exit code of a container whose end the engine did not see.
UNSEEN_EXIT = 255
_NEVER = "0001-"
# Every Podman since 4.0 serves it.
_LIBPOD_VERSION = "v4.0.0"
_NVIDIA_HOOK = "nvidia-container-runtime-hook"
_SOCKETS = ("/var/run/docker.sock", "/run/podman/podman.sock")


class EngineUnavailable(Exception):
    """The engine did not answer, or stopped in the middle of an answer."""


class EngineError(Exception):
    """The engine refused a request."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


class EngineInfo(NamedTuple):
    """`architecture` as images name it: amd64, arm64. `has_nvidia`, `has_cdi`: its ways to give devices to containers.

    `ends_with_containers`: a restart of the engine ends its containers. `is_rootless`: an ordinary user's, whose
    containers have that user as their root. `bounds_memory`: it limits memory, cores and processes of containers.
    """

    architecture: str
    is_podman: bool
    ends_with_containers: bool
    has_nvidia: bool = False
    has_cdi: bool = False
    is_rootless: bool = False
    bounds_memory: bool = True


class ImageInfo(NamedTuple):
    """`digests` are `name@sha256:…`, by registry. `entrypoint` and `command` together are its default command line.

    `python_path` is the variable PYTHONPATH that it sets, or empty.
    """

    id: str
    digests: tuple[str, ...]
    architecture: str
    volumes: tuple[str, ...]
    entrypoint: tuple[str, ...]
    command: tuple[str, ...]
    python_path: str = ""


class ContainerInfo(NamedTuple):
    """`pid` is 0 where it does not run; `exit_code` is valid once it has exited."""

    id: str
    status: str
    pid: int
    exit_code: int
    was_out_of_memory: bool
    labels: dict[str, str]


class OutputPiece(NamedTuple):
    """Output of a container; `stream` is 1 for stdout, 2 for stderr."""

    stream: int
    data: bytes


def find_socket() -> Path | None:
    """Return the socket of the engine of this machine: `DOCKER_HOST`, or one of the usual paths."""
    host = os.environ.get("DOCKER_HOST")
    if host is not None:
        return Path(host.removeprefix("unix://")) if host.startswith("unix://") else None
    of_user = [f"{os.environ['XDG_RUNTIME_DIR']}/podman/podman.sock"] if "XDG_RUNTIME_DIR" in os.environ else []
    return next((Path(path) for path in (*_SOCKETS, *of_user) if Path(path).is_socket()), None)


class DockerClient:
    """A client of the engine that listens on a Unix socket.

    Raises:
        EngineUnavailable, EngineError: from all methods.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def info(self) -> EngineInfo:
        """Return what the engine is."""
        architecture = self._request("GET", "/version")["Arch"]
        info = self._request("GET", "/info")
        if self._is_podman():
            is_rootless = bool(info.get("Rootless"))
            return EngineInfo(
                architecture,
                is_podman=True,
                # Its containers do not depend on a daemon.
                ends_with_containers=False,
                has_cdi=True,
                is_rootless=is_rootless,
                # It reports those of the machine, which an ordinary user may not set.
                bounds_memory=not (is_rootless and str(info.get("CgroupVersion")) == "1"),
            )
        ends = info.get("LiveRestoreEnabled") is False
        # Docker looks for this program when it starts, whether it also has a runtime of that name or not.
        has_nvidia = "nvidia" in (info.get("Runtimes") or {}) or shutil.which(_NVIDIA_HOOK) is not None
        return EngineInfo(
            architecture,
            is_podman=False,
            ends_with_containers=ends,
            has_nvidia=has_nvidia,
            has_cdi=bool(info.get("CDISpecDirs")),
            is_rootless="name=rootless" in (info.get("SecurityOptions") or ()),
            bounds_memory=info.get("MemoryLimit") is not False,
        )

    def _is_podman(self) -> bool:
        try:
            with self._open("GET", "/libpod/_ping"):
                return True
        except EngineError:
            return False

    def find_image(self, name: str) -> ImageInfo | None:
        """Return a local image, by name, digest or id."""
        image = self._find(f"/images/{quote(name)}/json")
        if image is None:
            return None
        config = image.get("Config") or {}
        volumes, entrypoint, command = (tuple(config.get(key) or ()) for key in ("Volumes", "Entrypoint", "Cmd"))
        digests = tuple(image["RepoDigests"] or ())
        variables = dict(entry.partition("=")[::2] for entry in config.get("Env") or ())
        python_path = variables.get("PYTHONPATH", "")
        return ImageInfo(image["Id"], digests, image["Architecture"], volumes, entrypoint, command, python_path)

    def pull(self, name: str, tag: str, *, architecture: str, credentials: Mapping[str, str] | None) -> None:
        """Pull an image; `tag` may be a digest."""
        query = {"fromImage": name, "tag": tag, "platform": f"linux/{architecture}"}
        headers = {"X-Registry-Auth": _encoded(credentials)} if credentials else {}
        path = f"/images/create?{urlencode(query)}"
        with self._open("POST", path, headers=headers, timeout_s=_PULL_TIMEOUT_S) as answer:
            for line in answer:
                # A truncated line has no error, and the image is missing afterwards.
                if line.endswith(b"\n") and "error" in (message := json.loads(line)):
                    raise EngineError(HTTPStatus.BAD_GATEWAY, message["error"])

    def create(self, name: str, description: Mapping[str, object]) -> None:
        """Create a container."""
        self._request("POST", f"/containers/create?{urlencode({'name': name})}", description)

    def create_by_libpod(self, description: Mapping[str, object]) -> None:
        """Create a container by the API that only Podman has; its description contains its name."""
        self._request("POST", f"/{_LIBPOD_VERSION}/libpod/containers/create", description)

    def has_file(self, name: str, path: str) -> bool:
        """Whether a container, running or not, has a file."""
        try:
            with self._open("HEAD", f"/containers/{name}/archive?{urlencode({'path': path})}"):
                return True
        except EngineError as error:
            if error.status == HTTPStatus.NOT_FOUND:
                return False
            raise

    def start(self, name: str) -> None:
        """Start a container."""
        self._request("POST", f"/containers/{name}/start")

    def kill(self, name: str, signal_name: str) -> None:
        """Send a signal to the first process of a container."""
        self._request("POST", f"/containers/{name}/kill?signal={signal_name}")

    def find_container(self, name: str) -> ContainerInfo | None:
        """Return a container, or None where there is none of that name."""
        path = f"/containers/{name}/json"
        try:
            container = self._find(path)
        except EngineError as error:
            # Podman before 4.4 fails once where the first process disappears while it looks at it.
            if error.status != HTTPStatus.INTERNAL_SERVER_ERROR:
                raise
            container = self._find(path)
        if container is None:
            return None
        state = container["State"]
        status, exit_code = state["Status"], state["ExitCode"]
        # After a crash of the machine Podman reports that a container never ran, but also when it started.
        if not state["Pid"] and not state["StartedAt"].startswith(_NEVER) and state["FinishedAt"].startswith(_NEVER):
            status, exit_code = "exited", UNSEEN_EXIT
        labels = (container.get("Config") or {}).get("Labels") or {}
        return ContainerInfo(container["Id"], status, state["Pid"], exit_code, bool(state["OOMKilled"]), labels)

    def was_killed(self, name: str) -> bool:
        """Whether the engine remembers that a container was stopped, or sent a signal, by request."""
        # Podman loses events with `until`; Docker never ends the response without it.
        end = {"stream": "false"} if self._is_podman() else {"until": f"{time.time():.6f}"}
        filters = json.dumps({"container": [name], "event": ["kill", "stop"]})
        try:
            with self._open("GET", f"/events?{urlencode({'since': 1, **end, 'filters': filters})}") as answer:
                return bool(answer.read().strip())
        except EngineError:
            # A Podman without an event log.
            return False

    def remove(self, name: str) -> None:
        """Kill a container if it runs, and remove it with its anonymous volumes."""
        try:
            self._request("DELETE", f"/containers/{name}?force=1&v=1")
        except EngineError as error:
            if error.status not in (HTTPStatus.NOT_FOUND, HTTPStatus.CONFLICT):
                raise

    def list_labelled(self, label: str, *, only_running: bool = False) -> list[tuple[str, dict[str, str]]]:
        """Return the ids and labels of all containers with a label, which may be `name=value`."""
        filters = json.dumps({"label": [label]})
        containers = self._request(
            "GET", f"/containers/json?{urlencode({'all': int(not only_running), 'filters': filters})}"
        )
        return [(container["Id"], container["Labels"]) for container in containers]

    def log(self, name: str, *, follow: bool, since_ns: int = 0) -> Iterator[list[OutputPiece]]:
        """Yield the stored output of a container, in batches; then new output, where `follow`."""
        since = f"{since_ns // 10**9}.{since_ns % 10**9:09d}"
        query = {"follow": int(follow), "stdout": 1, "stderr": 1, "since": since}
        with self._open("GET", f"/containers/{name}/logs?{urlencode(query)}", timeout_s=None) as answer:
            yield from _frames(answer)

    def _find(self, path: str) -> Any:
        try:
            return self._request("GET", path)
        except EngineError as error:
            if error.status == HTTPStatus.NOT_FOUND:
                return None
            raise

    def _request(self, method: str, path: str, body: Mapping[str, object] | None = None) -> Any:
        with self._open(method, path, body) as answer:
            text = answer.read()
        try:
            return json.loads(text) if text else None
        except ValueError as error:
            raise EngineUnavailable(f"The container engine at {self.path} stopped in the middle") from error

    @contextmanager
    def _open(
        self,
        method: str,
        path: str,
        body: Mapping[str, object] | None = None,
        *,
        headers: Mapping[str, str] | None = None,
        timeout_s: float | None = _TIMEOUT_S,
    ) -> Iterator[BufferedReader]:
        data = b"" if body is None else json.dumps(body).encode()
        fields = {"Host": "engine", "Content-Type": "application/json", "Content-Length": len(data), **(headers or {})}
        # HTTP/1.0: the answer ends with the connection and is not chunked.
        head = f"{method} {path} HTTP/1.0\r\n" + "".join(f"{name}: {value}\r\n" for name, value in fields.items())
        try:
            with socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(timeout_s)
                connection.connect(str(self.path))
                connection.sendall(head.encode() + b"\r\n" + data)
                with connection.makefile("rb") as answer:
                    status = _read_head(answer)
                    if status >= HTTPStatus.BAD_REQUEST:
                        raise EngineError(status, _message(answer.read()))
                    yield answer
        except OSError as error:
            raise EngineUnavailable(f"The container engine at {self.path} does not answer: {error}") from error


def _read_head(answer: BufferedReader) -> int:
    words = answer.readline().split()
    while (line := answer.readline()) not in (b"\r\n", b"\n"):
        if not line:
            raise OSError("it stopped in the middle")
    return int(words[1])


def _message(text: bytes) -> str:
    try:
        return str(json.loads(text)["message"]).strip()
    except (ValueError, KeyError, TypeError):
        return text.decode(errors="replace").strip()


def _frames(answer: BufferedReader) -> Iterator[list[OutputPiece]]:
    """Yield complete frames, in batches. A frame: one byte for the stream, three unused, four for the size."""
    pending = b""
    while data := answer.read1(2**18):
        pending += data
        position, pieces = 0, []
        while position + 8 <= len(pending):
            end = position + 8 + int.from_bytes(pending[position + 4 : position + 8], "big")
            if end > len(pending):
                break
            pieces.append(OutputPiece(pending[position], pending[position + 8 : end]))
            position = end
        pending = pending[position:]
        if pieces:
            yield pieces


def digest_of(image: ImageInfo, name: ImageName) -> str:
    """Return the digest in the registry of the name; the id where the image is in no registry."""
    if name.digest:
        return name.digest
    digests = [full.partition("@")[2] for full in image.digests if parse_image_name(full).repository == name.repository]
    return digests[-1] if digests else image.id


def _encoded(credentials: Mapping[str, str]) -> str:
    return base64.urlsafe_b64encode(json.dumps(credentials).encode()).decode()
