"""A Docker daemon for tests, with folders, socket and registry of its own."""

from __future__ import annotations

import functools
import hashlib
import io
import itertools
import json
import os
import socket
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.runner.executors.docker.client import DockerClient, EngineUnavailable
from kleinkram.runner.executors.docker.container import SHELL
from tests.requirements import path_of

IMAGE = "kleinkram.test/python"
PROGRAMS = ("dockerd", "containerd", "docker", "docker-registry", "ip", "iptables")
_LEFT_OUT = {"test", "tests", "idlelib", "tkinter", "lib2to3", "ensurepip", "site-packages", "turtledemo", "pydoc_data"}


# Modules that a worker goes through may each have one at the same time.
_numbers = itertools.count(77)


@contextmanager
def bridge() -> Iterator[tuple[str, str]]:
    """Create a network for containers, and yield its interface and the address of this machine in it."""
    name = f"kl{os.getpid()}-{next(_numbers)}"
    _ip("link", "add", name, "type", "bridge")
    try:
        # By the number that the kernel gave it: no other that is there, be it left by a killed round, has the same.
        number = int(Path(f"/sys/class/net/{name}/ifindex").read_text())
        address = f"10.{number // 256 % 50 + 200}.{number % 256}.1"
        _ip("address", "add", f"{address}/24", "dev", name)
        _ip("link", "set", name, "up")
        yield name, address
    finally:
        _ip("link", "delete", name)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@dataclass
class Dockerd:
    """A Docker daemon for tests. `bridge` is its network interface, `gateway` the address of this machine in it."""

    folder: Path
    bridge: str = "none"
    gateway: str = "127.0.0.1"
    options: tuple[str, ...] = ()
    process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    containerd: subprocess.Popen[bytes] | None = field(default=None, init=False)

    @property
    def socket(self) -> Path:
        return self.folder / "docker.sock"

    @property
    def engine(self) -> DockerClient:
        return DockerClient(self.socket)

    def start(self) -> None:
        """Start it, again after `kill`, and wait until it answers."""
        (self.folder / "none.json").write_text("{}")
        state, data = self.folder / "state", self.folder / "data"
        if self.containerd is None:
            self.containerd = self._run(
                *("containerd", "--config", "/dev/null", "--address", state / "containerd.sock"),
                *("--root", data / "containerd", "--state", state / "containerd"),
            )
        (self.folder / "docker.pid").unlink(missing_ok=True)
        self.process = self._run(
            *("dockerd", "--host", f"unix://{self.socket}", "--config-file", self.folder / "none.json"),
            *("--data-root", data, "--exec-root", state, "--pidfile", self.folder / "docker.pid"),
            *(
                "--containerd",
                state / "containerd.sock",
                "--bridge",
                self.bridge,
                "--iptables=false",
                "--ip-masq=false",
            ),
            *self.options,
        )
        self.wait_until_it_answers(self.process, "dockerd")

    def wait_until_it_answers(self, process: subprocess.Popen[bytes], program: str) -> None:
        """Wait for the answers of what was started as this program."""
        until = time.monotonic() + 60
        while not self._answers():
            assert process.poll() is None, (self.folder / f"{program}.log").read_text()[-3000:]
            assert time.monotonic() < until, f"{program} does not answer"
            time.sleep(0.05)

    def _run(self, program: str, *words: str | Path, **settings: str) -> subprocess.Popen[bytes]:
        result = path_of(program)
        assert result is not None
        environment = {"PATH": f"{os.environ['PATH']}:/usr/sbin", "HOME": str(self.folder), **settings}
        with (self.folder / f"{program}.log").open("ab") as log:
            return subprocess.Popen([result, *words], stdout=log, stderr=log, env=environment, start_new_session=True)

    def _answers(self) -> bool:
        try:
            self.engine.info()
        except EngineUnavailable:
            return False
        return True

    def kill(self) -> None:
        """Kill it with SIGKILL."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def end(self) -> None:
        """Remove all containers and end it, with all that it has mounted."""
        for name, _ in self.engine.list_labelled("kleinkram.run"):
            self.engine.remove(name)
        for one in (self.process, self.containerd):
            assert one is not None
            one.terminate()
            one.wait(30)
        places = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
        for place in reversed([one for one in places if Path(one).is_relative_to(self.folder)]):
            subprocess.run(["umount", "--lazy", place], check=False)

    def docker(self, *words: str, inputs: bytes | None = None) -> str:
        """Run Docker's own command line on it."""
        program = path_of("docker")
        assert program is not None
        environment = {"PATH": os.environ["PATH"], "DOCKER_HOST": f"unix://{self.socket}", "HOME": str(self.folder)}
        done = subprocess.run([program, *words], input=inputs, capture_output=True, env=environment, check=False)
        assert done.returncode == 0, f"docker {' '.join(words)}: {done.stderr.decode()}"
        return done.stdout.decode().strip()

    def load(self, name: str, *changes: str, root: bytes) -> str:
        """Make an image of the files of a tar, and return its id."""
        values = [word for change in changes for word in ("--change", change)]
        return self.docker("import", *values, "-", name, inputs=root)

    def load_foreign(self, name: str, root: bytes, architecture: str) -> None:
        """Make an image for another kind of machine of the files of a tar."""
        layer = f"sha256:{hashlib.sha256(root).hexdigest()}"
        facts = {"architecture": architecture, "os": "linux", "rootfs": {"type": "layers", "diff_ids": [layer]}}
        manifest = [{"Config": "config.json", "RepoTags": [name], "Layers": ["layer.tar"]}]
        files = {"config.json": json.dumps(facts), "manifest.json": json.dumps(manifest)}
        self.docker("load", inputs=root_of({**{key: text.encode() for key, text in files.items()}, "layer.tar": root}))


@functools.cache
def python_root(*, with_shell: bool = True) -> bytes:
    """Return a tar of a root with this Python, a shell, their libraries and the folders of runs."""
    shell = [Path(SHELL)] if with_shell else []
    libraries = Path(sysconfig.get_path("stdlib"))
    program = Path(sys.executable).resolve()
    needed = [program, *(libraries / "lib-dynload").glob("*.so"), *shell]
    with io.BytesIO() as stream, tarfile.open(fileobj=stream, mode="w") as tar:
        shared = sorted({path for file in needed for path in _libraries_of(file)})
        # Docker without root makes folders that are not in the tar unreadable.
        for parent in _parents(*map(Path, shared), *needed, libraries, Path("/usr/bin/python3")):
            if not parent.is_relative_to(libraries):
                _folder(tar, str(parent)[1:])
        for one in shared:
            tar.add(Path(one).resolve(), one, recursive=False)
        for file in (program, *shell):
            tar.add(file.resolve(), file)
        tar.add(libraries, libraries, filter=_is_included)
        _link(tar, "/usr/bin/python3", str(program))
        for folder in ("in", "out", "tmp", "etc"):
            _folder(tar, folder)
        tar.close()
        return stream.getvalue()


def _parents(*paths: Path) -> list[Path]:
    """Return the folders that these are in, each after its own, without the root."""
    return sorted({parent for path in paths for parent in path.parents if parent != Path("/")})


def _libraries_of(file: Path) -> list[str]:
    values = subprocess.run(["ldd", str(file)], capture_output=True, text=True, check=False).stdout
    return [word for line in values.splitlines() for word in line.split() if word.startswith("/") and ":" not in word]


def _is_included(entry: tarfile.TarInfo) -> tarfile.TarInfo | None:
    name = Path(entry.name)
    if _LEFT_OUT & set(name.parts) or name.suffix == ".a" or any(part.startswith("config-") for part in name.parts):
        return None
    return None if name.suffix == ".pyc" and sys.implementation.cache_tag not in name.name.split(".")[1:-1] else entry


def _link(tar: tarfile.TarFile, name: str, target: str) -> None:
    entry = tarfile.TarInfo(name[1:])
    entry.type, entry.linkname = tarfile.SYMTYPE, target
    tar.addfile(entry)


def _folder(tar: tarfile.TarFile, name: str) -> None:
    entry = tarfile.TarInfo(name)
    entry.type, entry.mode = tarfile.DIRTYPE, 0o755
    tar.addfile(entry)


@contextmanager
def dockerd(bridge: str = "none", gateway: str = "127.0.0.1", *options: str) -> Iterator[Dockerd]:
    """Start a Docker daemon in its own folder, which is removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="klein-docker-") as folder:
        made = Dockerd(Path(folder), bridge, gateway, options)
        made.start()
        try:
            yield made
        finally:
            made.end()


@dataclass
class Registry:
    """A registry for tests: Debian's `docker-registry`, without TLS. It listens at `address`."""

    folder: Path
    port: int
    address: str = "127.0.0.1"
    process: subprocess.Popen[bytes] | None = field(default=None, init=False)

    @property
    def place(self) -> str:
        return f"127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start it and wait until it answers."""
        program = path_of("docker-registry")
        assert program is not None
        self.folder.mkdir(exist_ok=True)
        settings = {
            "version": "0.1",
            "log": {"level": "error"},
            "storage": {"filesystem": {"rootdirectory": str(self.folder / "data")}},
            "http": {"addr": f"{self.address}:{self.port}"},
        }
        (self.folder / "config.json").write_text(json.dumps(settings))
        with (self.folder / "registry.log").open("ab") as log:
            self.process = subprocess.Popen([program, "serve", self.folder / "config.json"], stdout=log, stderr=log)
        until = time.monotonic() + 30
        while not self._answers():
            assert time.monotonic() < until, (self.folder / "registry.log").read_text()
            time.sleep(0.05)

    def _answers(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self.port), 1).close()
        except OSError:
            return False
        return True

    def end(self) -> None:
        """End it."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            self.process.wait(30)


def root_of(files: dict[str, bytes]) -> bytes:
    """Return a tar of a root with these executable files and the folders of runs."""
    with io.BytesIO() as stream, tarfile.open(fileobj=stream, mode="w") as tar:
        for folder in ("in", "out", "tmp", "etc"):
            _folder(tar, folder)
        for name, data in files.items():
            entry = tarfile.TarInfo(name)
            entry.mode, entry.size = 0o755, len(data)
            tar.addfile(entry, io.BytesIO(data))
        tar.close()
        return stream.getvalue()
