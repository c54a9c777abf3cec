"""A package index for tests: wheels made here, in a folder, and served on loopback as a simple index.

Source: PEP 503 (simple index), PEP 427 (wheels).
"""

from __future__ import annotations

import base64
import hashlib
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.http_server import QuietHandler, serving


@dataclass
class PackageIndex:
    """Wheels in a folder. `requests` are the paths that were asked for; `delay_s` makes answers with files slow."""

    folder: Path
    url: str = ""
    requests: list[str] = field(default_factory=list)
    delay_s: float = 0
    status: int = 200

    def add(
        self,
        name: str,
        version: str,
        files: Mapping[str, str] | None = None,
        *,
        requires: Sequence[str] = (),
        requires_python: str = ">=3.8",
        tag: str = "py3-none-any",
    ) -> Path:
        """Make a wheel, by default of one module that names its version."""
        module = name.replace("-", "_")
        info = f"{module}-{version}.dist-info"
        lines = ["Metadata-Version: 2.1", f"Name: {name}", f"Version: {version}", f"Requires-Python: {requires_python}"]
        lines += [f"Requires-Dist: {requirement}" for requirement in requires]
        content = dict(files if files is not None else {f"{module}.py": f"VERSION = {version!r}\n"})
        content[f"{info}/METADATA"] = "\n".join(lines) + "\n"
        content[f"{info}/WHEEL"] = f"Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: {tag}\n"
        record = "".join(f"{path},{_record_hash(text)},{len(text.encode())}\n" for path, text in content.items())
        content[f"{info}/RECORD"] = f"{record}{info}/RECORD,,\n"
        wheel = self.folder / f"{module}-{version}-{tag}.whl"
        with zipfile.ZipFile(wheel, "w") as archive:
            for path, text in content.items():
                archive.writestr(zipfile.ZipInfo(path, (2024, 1, 1, 0, 0, 0)), text)
        return wheel

    def add_source(self, name: str, version: str) -> Path:
        """Make a source distribution, which nothing may build."""
        archive = self.folder / f"{name}-{version}.tar.gz"
        archive.write_bytes(b"not even an archive")
        return archive

    def downloads(self) -> list[str]:
        """Return the names of the wheels that were downloaded."""
        return [path.rpartition("/")[2] for path in self.requests if path.startswith("/files/")]


@contextmanager
def serve_index(folder: Path) -> Iterator[PackageIndex]:
    """Serve the wheels of a folder, which is created."""
    folder.mkdir(parents=True, exist_ok=True)
    index = PackageIndex(folder)

    class Handler(QuietHandler):
        def do_GET(self) -> None:
            index.requests.append(self.path)
            if self.path.startswith("/files/"):
                time.sleep(index.delay_s)
            self.wfile.write(self._begin())

        def do_HEAD(self) -> None:
            self._begin()

        def _begin(self) -> bytes:
            status, body, kind = _answer(index, self.path)
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            return body

    with serving(Handler) as port:
        index.url = f"http://127.0.0.1:{port}/simple"
        yield index


def _answer(index: PackageIndex, path: str) -> tuple[int, bytes, str]:
    if index.status != 200:
        return index.status, b"", "text/plain"
    kind, _, name = path.strip("/").partition("/")
    if kind == "files" and (index.folder / name).is_file():
        return 200, (index.folder / name).read_bytes(), "application/octet-stream"
    wheels = [
        file for file in sorted(index.folder.iterdir()) if _normalized(file.name.split("-")[0]) == name.strip("/")
    ]
    if kind != "simple" or not wheels:
        return 404, b"", "text/plain"
    links = [f'<a href="/files/{file.name}#sha256={_sha256(file)}">{file.name}</a>' for file in wheels]
    return 200, f"<!DOCTYPE html><html><body>{''.join(links)}</body></html>".encode(), "text/html"


def _normalized(name: str) -> str:
    return name.lower().replace("_", "-")


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _record_hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"sha256={base64.urlsafe_b64encode(digest).rstrip(b'=').decode()}"
