"""The sides of the benchmark of recording previews, each run as a process of its own (see `side`).

Both verify a recording as the worker does: pieces from a store over HTTP, three checksums, and a child process that
scans them, no faster than workers do by default. One side has its preview made at the same time.
"""

import asyncio
import hashlib
import time
import uuid
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

from benchmarks.range_server import serving
from benchmarks.side import Facts, main
from kleinkram.contract.uploads import crc64nvme
from kleinkram.recordings.isolation import PreviewRequest, StreamRequest, request_bytes
from kleinkram.recordings.previews import read_preview
from kleinkram.server.blobs.readers import ReaderProcesses

_PIECE_BYTES = 2**20
_TIMEOUT_S, _MEMORY_BYTES = 600, 2**30
_BYTES_PER_S = 100_000_000  # the default of KLEINKRAM_VERIFY_BYTES_PER_S


class _Recording(NamedTuple):
    path: Path
    size_bytes: int

    @classmethod
    def of(cls, path: Path) -> "_Recording":
        return cls(path, path.stat().st_size)


def verify(path: str) -> Facts:
    """Verify a recording."""
    return asyncio.run(_measure(_Recording.of(Path(path)), with_preview=False))


def verify_with_preview(path: str) -> Facts:
    """Verify a recording, while its preview is made."""
    return asyncio.run(_measure(_Recording.of(Path(path)), with_preview=True))


async def _measure(recording: _Recording, *, with_preview: bool) -> Facts:
    with serving(recording.path) as url:
        async with ReaderProcesses() as readers:
            start = time.perf_counter()
            preview = asyncio.create_task(_preview(readers, recording, url)) if with_preview else None
            await _verify(readers, recording, url)
            facts: Facts = {"verified_s": time.perf_counter() - start}
            if preview is not None:
                data = await preview
                contents = read_preview(data)
                facts["preview_bytes"] = len(data)
                facts["fields"] = sum(len(series.fields) for series in contents.series)
                facts["thumbnails"] = sum(len(strip.thumbnails) for strip in contents.cameras)
            facts["seconds"] = time.perf_counter() - start
    return facts


async def _verify(readers: ReaderProcesses, recording: _Recording, url: str) -> None:
    sha256, md5, crc, done_bytes = hashlib.sha256(), hashlib.md5(usedforsecurity=False), 0, 0
    start = time.perf_counter()
    announced = StreamRequest(recording.size_bytes, recording.path.name)
    request = request_bytes(announced, memory_bytes=_MEMORY_BYTES, timeout_s=_TIMEOUT_S)
    response = await asyncio.to_thread(_get, url, recording.size_bytes)
    async with readers.parse_stream(request, owner=uuid.uuid4(), timeout_s=_TIMEOUT_S) as child:
        while piece := await asyncio.to_thread(response.read, _PIECE_BYTES):
            crc = await asyncio.to_thread(_digest, piece, sha256, md5, crc)
            await child.feed(piece)
            done_bytes += len(piece)
            await asyncio.sleep(max(0.0, done_bytes / _BYTES_PER_S - (time.perf_counter() - start)))
        if (await child.summary()).message_count == 0:
            raise SystemExit("the scan counted no messages")


def _get(url: str, size_bytes: int) -> HTTPResponse:
    parts = urlsplit(url)
    connection = HTTPConnection(parts.hostname or "", parts.port)
    connection.request("GET", "/", headers={"Range": f"bytes=0-{size_bytes - 1}"})
    return connection.getresponse()


def _digest(piece: bytes, sha256: "hashlib._Hash", md5: "hashlib._Hash", crc: int) -> int:
    sha256.update(piece)
    md5.update(piece)
    return int(crc64nvme(piece, crc))


async def _preview(readers: ReaderProcesses, recording: _Recording, url: str) -> bytes:
    announced = PreviewRequest(url, recording.size_bytes, recording.path.name)
    request = request_bytes(announced, memory_bytes=_MEMORY_BYTES, timeout_s=_TIMEOUT_S)
    return (await readers.preview(request, owner=uuid.uuid4(), timeout_s=_TIMEOUT_S)).data


if __name__ == "__main__":
    main([verify, verify_with_preview])
