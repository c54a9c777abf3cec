"""What is said to an engine of containers, over its Unix socket: Docker's API, which Podman speaks as well.

Imports nothing but Python's own library, since wardens wait for it. Every call is a connection of its own, so threads
may share an engine.
"""

import json
import os
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from io import BufferedReader
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, urlencode

from kleinkram.runner.docker.log import Piece

_TIMEOUT_S = 60.0
# A registry that does not answer: engines themselves give up sooner.
_PULL_TIMEOUT_S = 300.0
# What engines give to a container whose end they did not see.
UNSEEN = 255
_NEVER = "0001-"
_SOCKETS = ("/var/run/docker.sock", "/run/podman/podman.sock")


class EngineAway(Exception):
    """The engine did not answer, or stopped in the middle."""


class Refused(Exception):
    """The engine answered that it will not."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


class Facts(NamedTuple):
    """What an engine says of itself. `architecture` as images say it: amd64, arm64.

    `has_gpus`: to be had by device request. `ends_with_containers`: when it is restarted, containers are ended.
    """

    architecture: str
    has_gpus: bool
    ends_with_containers: bool


class Image(NamedTuple):
    """What an engine says of an image it has. `digests` are `name@sha256:…`, by the registries it came from.

    `entry` and `command` together are what it runs of itself; a run's own command takes the place of `command`.
    """

    id: str
    digests: tuple[str, ...]
    architecture: str
    volumes: tuple[str, ...]
    entry: tuple[str, ...]
    command: tuple[str, ...]


class Container(NamedTuple):
    """What an engine says of a container. `pid` is 0 where it does not run, and `exit_code` of no meaning before."""

    id: str
    status: str
    pid: int
    exit_code: int
    was_out_of_memory: bool
    error: str


def find_socket() -> Path | None:
    """Return where the engine of this machine listens: `DOCKER_HOST` if that is set, else where engines usually do."""
    said = os.environ.get("DOCKER_HOST")
    if said is not None:
        return Path(said.removeprefix("unix://")) if said.startswith("unix://") else None
    own = [f"{os.environ['XDG_RUNTIME_DIR']}/podman/podman.sock"] if "XDG_RUNTIME_DIR" in os.environ else []
    return next((Path(path) for path in (*_SOCKETS, *own) if Path(path).is_socket()), None)


class Engine:
    """An engine of containers on this machine."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def facts(self) -> Facts:
        """Return what it says of itself."""
        architecture = self._ask("GET", "/version")["Arch"]
        if self._is_podman():
            # It passes over requests for devices, and its containers have no daemon to end with.
            return Facts(architecture, has_gpus=False, ends_with_containers=False)
        info = self._ask("GET", "/info")
        ends = info.get("LiveRestoreEnabled") is False
        return Facts(architecture, "nvidia" in (info.get("Runtimes") or {}), ends)

    def _is_podman(self) -> bool:
        try:
            with self._answer("GET", "/libpod/_ping"):
                return True
        except Refused:
            return False

    def find_image(self, name: str) -> Image | None:
        """Return an image that is here, by name, digest or id."""
        try:
            said = self._ask("GET", f"/images/{quote(name)}/json")
        except Refused as error:
            if error.status == HTTPStatus.NOT_FOUND:
                return None
            raise
        config = said.get("Config") or {}
        volumes, entry, command = (tuple(config.get(key) or ()) for key in ("Volumes", "Entrypoint", "Cmd"))
        return Image(said["Id"], tuple(said["RepoDigests"] or ()), said["Architecture"], volumes, entry, command)

    def pull(self, name: str, tag: str, *, architecture: str, credentials: str | None) -> None:
        """Fetch an image; `tag` may be a digest.

        Raises:
            Refused: it cannot be had.
        """
        query = {"fromImage": name, "tag": tag, "platform": f"linux/{architecture}"}
        headers = {"X-Registry-Auth": credentials} if credentials else {}
        path = f"/images/create?{urlencode(query)}"
        with self._answer("POST", path, headers=headers, timeout_s=_PULL_TIMEOUT_S) as answer:
            for line in answer:
                # Cut short, it names no error, and the image is not there.
                if line.endswith(b"\n") and "error" in (said := json.loads(line)):
                    raise Refused(HTTPStatus.BAD_GATEWAY, said["error"])

    def create(self, name: str, description: Mapping[str, object]) -> None:
        """Make a container that does not run yet."""
        self._ask("POST", f"/containers/create?{urlencode({'name': name})}", description)

    def has_file(self, name: str, path: str) -> bool:
        """Whether a container has a file, which is not looked into; the container need not run."""
        try:
            with self._answer("HEAD", f"/containers/{name}/archive?{urlencode({'path': path})}"):
                return True
        except Refused as error:
            if error.status == HTTPStatus.NOT_FOUND:
                return False
            raise

    def start(self, name: str) -> None:
        """Start a container."""
        self._ask("POST", f"/containers/{name}/start")

    def kill(self, name: str, sign: str) -> None:
        """Send a signal to the first process of a container."""
        self._ask("POST", f"/containers/{name}/kill?signal={sign}")

    def wait(self, name: str) -> None:
        """Return once a container does not run."""
        with self._answer("POST", f"/containers/{name}/wait", timeout_s=None) as answer:
            # An engine that is killed says nothing more, and not that it does.
            if not answer.read():
                raise EngineAway(f"The engine of containers at {self.path} stopped in the middle")

    def find(self, name: str) -> Container | None:
        """Return a container, or None where there is none of that name."""
        try:
            said = self._described(name)
        except Refused as error:
            if error.status == HTTPStatus.NOT_FOUND:
                return None
            raise
        state = said["State"]
        status, exit_code = state["Status"], state["ExitCode"]
        # A Podman that went down with its machine says later that it never ran, but when it began.
        if not state["Pid"] and not state["StartedAt"].startswith(_NEVER) and state["FinishedAt"].startswith(_NEVER):
            status, exit_code = "exited", UNSEEN
        killed, error_said = bool(state["OOMKilled"]), state.get("Error") or ""
        return Container(said["Id"], status, state["Pid"], exit_code, killed, error_said)

    def _described(self, name: str) -> Any:
        path = f"/containers/{name}/json"
        try:
            return self._ask("GET", path)
        except Refused as error:
            # Podman before 4.4 fails where the first process is gone while it looks at that, which it is only once.
            if error.status != HTTPStatus.INTERNAL_SERVER_ERROR:
                raise
            return self._ask("GET", path)

    def was_told_to_kill(self, name: str) -> bool:
        """Whether anybody had a container stopped or sent a signal, as far as it remembers."""
        # Podman loses what it has when it is asked for events until now; Docker goes on for ever when it is not.
        end = {"stream": "false"} if self._is_podman() else {"until": f"{time.time():.6f}"}
        filters = json.dumps({"container": [name], "event": ["kill", "stop"]})
        try:
            with self._answer("GET", f"/events?{urlencode({'since': 1, **end, 'filters': filters})}") as answer:
                return bool(answer.read().strip())
        except Refused:
            # A Podman that is told to remember nothing.
            return False

    def remove(self, name: str) -> None:
        """Kill a container if it runs, and remove it with the volumes that nobody named."""
        try:
            self._ask("DELETE", f"/containers/{name}?force=1&v=1")
        except Refused as error:
            if error.status not in (HTTPStatus.NOT_FOUND, HTTPStatus.CONFLICT):
                raise

    def labelled(self, label: str) -> list[tuple[str, dict[str, str]]]:
        """Return ids and labels of all containers with a label, which may be `name=value`."""
        filters = json.dumps({"label": [label]})
        said = self._ask("GET", f"/containers/json?{urlencode({'all': 1, 'filters': filters})}")
        return [(each["Id"], each["Labels"]) for each in said]

    @contextmanager
    def attached(self, name: str) -> Iterator[Iterator[list[Piece]]]:
        """Yield, in batches, what a container writes from now on, until it is over or the engine is."""
        path = f"/containers/{name}/attach?stream=1&stdout=1&stderr=1"
        with self._answer("POST", path, timeout_s=None) as answer:
            yield _frames(answer)

    def log(self, name: str, *, follow: bool, since_ns: int = 0) -> Iterator[list[Piece]]:
        """Yield, in batches, what a container has written, as far as that is kept; then what it writes, if followed."""
        since = f"{since_ns // 10**9}.{since_ns % 10**9:09d}"
        query = {"follow": int(follow), "stdout": 1, "stderr": 1, "since": since}
        with self._answer("GET", f"/containers/{name}/logs?{urlencode(query)}", timeout_s=None) as answer:
            yield from _frames(answer)

    def _ask(self, method: str, path: str, said: Mapping[str, object] | None = None) -> Any:
        with self._answer(method, path, said) as answer:
            text = answer.read()
        try:
            return json.loads(text) if text else None
        except ValueError as error:
            raise EngineAway(f"The engine of containers at {self.path} stopped in the middle") from error

    @contextmanager
    def _answer(
        self,
        method: str,
        path: str,
        said: Mapping[str, object] | None = None,
        *,
        headers: Mapping[str, str] | None = None,
        timeout_s: float | None = _TIMEOUT_S,
    ) -> Iterator[BufferedReader]:
        body = b"" if said is None else json.dumps(said).encode()
        sent = {"Host": "engine", "Content-Type": "application/json", "Content-Length": len(body), **(headers or {})}
        # With HTTP/1.0, an answer comes as it is: in 1.1, each line of a log would be a chunk to be taken apart.
        head = f"{method} {path} HTTP/1.0\r\n" + "".join(f"{name}: {value}\r\n" for name, value in sent.items())
        try:
            with socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(timeout_s)
                connection.connect(str(self.path))
                connection.sendall(head.encode() + b"\r\n" + body)
                with connection.makefile("rb") as answer:
                    status = _read_head(answer)
                    if status >= HTTPStatus.BAD_REQUEST:
                        raise Refused(status, _message(answer.read()))
                    yield answer
        except (OSError, _CutShort) as error:
            raise EngineAway(f"The engine of containers at {self.path} does not answer: {error}") from error


class _CutShort(Exception):
    pass


def _read_head(answer: BufferedReader) -> int:
    """Read status and headers, and return the first. No header matters: the answer ends with the connection."""
    words = answer.readline().split()
    while (line := answer.readline()) not in (b"\r\n", b"\n"):
        if not line:
            raise _CutShort("it stopped in the middle")
    return int(words[1])


def _message(text: bytes) -> str:
    try:
        return str(json.loads(text)["message"]).strip()
    except (ValueError, KeyError, TypeError):
        return text.decode(errors="replace").strip()


def _frames(answer: BufferedReader) -> Iterator[list[Piece]]:
    """Take frames apart: a byte for the stream, three of nothing, four for the size of what follows."""
    held = b""
    while data := answer.read1(2**18):
        held += data
        position, pieces = 0, []
        while position + 8 <= len(held):
            end = position + 8 + int.from_bytes(held[position + 4 : position + 8], "big")
            if end > len(held):
                break
            pieces.append(Piece(held[position], held[position + 8 : end]))
            position = end
        held = held[position:]
        yield pieces
