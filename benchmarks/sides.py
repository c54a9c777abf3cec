"""Sides of the transfer benchmarks, each run as a process of its own (see `side`).

"Raw" uses the same HTTP library, part size, concurrency and part checksums with the same store, without hashing and
without our API: checksums and signed URLs are computed before the clock starts.
"""

import asyncio
import hashlib
import os
import socket
import time
import uuid
from collections.abc import Awaitable, Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

import urllib3

from benchmarks.side import Facts, main
from kleinkram.client import connect
from kleinkram.client.transfer import download, plan_download, plan_upload, upload
from kleinkram.client.transfer.report import CONNECTIONS
from kleinkram.contract.files import DownloadLink, FileFilter
from kleinkram.contract.uploads import ChecksumKind, crc64nvme, part_size_bytes
from kleinkram.recordings import summarise
from kleinkram.recordings.http_source import HttpSource
from kleinkram.recordings.limits import PARALLEL_READS
from kleinkram.recordings.sources import CountingSource
from kleinkram.server.s3.storage import PartTarget, SignedRequest, Storage, open_storage
from kleinkram.server.settings import Settings

T = TypeVar("T")
_READ_BYTES = 8 * 1024 * 1024
_LINKS = 500  # per request


def upload_ours(project: str, mission: str, *paths: str) -> Facts:
    """Upload through the SDK, hashed and verified by the store."""
    with connect() as client:
        mission_id = client.missions.get(mission, project=project).id
        started = time.perf_counter()
        report = upload(client, mission_id, plan_upload(paths))
        seconds = time.perf_counter() - started
    _refuse_failure(report.failures)
    return {"seconds": seconds}


def _refuse_failure(failed: Iterable[object]) -> None:
    if problems := list(failed):
        raise SystemExit(f"transfers failed: {problems}")


@dataclass(frozen=True)
class _RawPart:
    path: Path
    offset: int
    signed: SignedRequest


@dataclass(frozen=True)
class _RawFile:
    key: str
    multipart_id: str | None
    crc64nvme: bytes
    parts: list[_RawPart]


def upload_raw(*paths: str) -> Facts:
    """Send the same parts with the same checksums to URLs signed before."""
    files = [(Path(path), Path(path).stat().st_size) for path in paths]
    prepared = asyncio.run(_with_storage(lambda storage: _prepare(storage, files)))
    pool = urllib3.PoolManager(maxsize=CONNECTIONS, blocksize=1024 * 1024)

    def send(part: _RawPart) -> None:
        with part.path.open("rb", buffering=0) as stream:
            stream.seek(part.offset)
            body = stream.read(int(part.signed.headers["Content-Length"]))
        answer = pool.request("PUT", part.signed.url, body=body, headers=part.signed.headers)
        if answer.status != 200:
            raise SystemExit(f"the store answered {answer.status}")

    started = time.perf_counter()
    with ThreadPoolExecutor(CONNECTIONS) as senders:
        list(senders.map(send, [part for file in prepared for part in file.parts]))
    asyncio.run(_with_storage(lambda storage: _join(storage, prepared)))
    return {"seconds": time.perf_counter() - started}


async def _prepare(storage: Storage, files: list[tuple[Path, int]]) -> list[_RawFile]:
    return [await _prepare_one(storage, path, size_bytes) for path, size_bytes in files]


async def _prepare_one(storage: Storage, path: Path, size_bytes: int) -> _RawFile:
    key = f"raw/{uuid.uuid4()}"
    part_bytes = part_size_bytes(size_bytes)
    multipart_id = await storage.create_multipart(key) if size_bytes > part_bytes else None
    parts, whole = [], 0
    with path.open("rb") as stream:
        for number, offset in enumerate(range(0, size_bytes, part_bytes), start=1):
            body = stream.read(part_bytes)
            whole = crc64nvme(body, whole)
            target = PartTarget(key, multipart_id, number, len(body), crc64nvme(body).to_bytes(8, "big").hex())
            parts.append(_RawPart(path, offset, storage.sign_part(target, expires_s=3600)))
    return _RawFile(key, multipart_id, whole.to_bytes(8, "big"), parts)


async def _join(storage: Storage, files: list[_RawFile]) -> None:
    for file in files:
        if file.multipart_id:
            count, crc = len(file.parts), file.crc64nvme
            await storage.complete_multipart(file.key, file.multipart_id, count=count, crc64nvme=crc)


async def _with_storage(work: Callable[[Storage], Awaitable[T]]) -> T:
    async with open_storage(Settings()) as storage:
        return await work(storage.with_checksum(ChecksumKind.crc64nvme))


def download_ours(mission: str, destination: str) -> Facts:
    """Download through the SDK, verified by SHA-256; `verify_s` is that part alone, done once more afterwards."""
    with connect() as client:
        files = list(client.files.list(FileFilter(mission=mission)))
        started = time.perf_counter()
        report = download(client, plan_download(files, Path(destination)))
        seconds = time.perf_counter() - started
    _refuse_failure(report.failures)
    before = time.process_time()
    started = time.perf_counter()
    for result in report.results:
        _hash(result.local)
    again = {"verify_s": time.perf_counter() - started, "verify_cpu_s": time.process_time() - before}
    return {"seconds": seconds, **again}


def _hash(path: Path) -> None:
    """Read a file as verification reads it."""
    sha256, piece = hashlib.sha256(), bytearray(1024 * 1024)
    with path.open("rb", buffering=0) as stream:
        while length := stream.readinto(piece):
            sha256.update(memoryview(piece)[:length])


def link_of(mission: str, path: str, url: str | None = None, token: str | None = None) -> DownloadLink:
    """Return a signed URL of a file; url and token are those of the environment by default."""
    with connect(url, token) as client:
        read = next(client.files.list(FileFilter(mission=mission, path=[path])))
        return client.files.links([read.id]).items[0]


def _links(mission: str) -> list[DownloadLink]:
    with connect() as client:
        ids = [read.id for read in client.files.list(FileFilter(mission=mission))]
        return [link for at in range(0, len(ids), _LINKS) for link in client.files.links(ids[at : at + _LINKS]).items]


def download_raw(mission: str, destination: str) -> Facts:
    """Fetch the same ranges with the same concurrency into files that are forced to disk, without processing them."""
    links = list(enumerate(_links(mission)))
    pool = urllib3.PoolManager(maxsize=CONNECTIONS)
    pieces = [
        (Path(destination) / str(number), link, offset)
        for number, link in links
        for offset in range(0, link.size_bytes, _READ_BYTES)
    ]

    def fetch(path: Path, link: DownloadLink, offset: int) -> None:
        end = min(offset + _READ_BYTES, link.size_bytes) - 1
        answer = pool.request("GET", link.url, headers={"Range": f"bytes={offset}-{end}"}, preload_content=False)
        position = offset
        out = os.open(path, os.O_CREAT | os.O_WRONLY)
        try:
            for piece in answer.stream(1024 * 1024):
                position += os.pwrite(out, piece, position)
            if link.size_bytes <= _READ_BYTES:
                os.fsync(out)
        finally:
            os.close(out)
        answer.release_conn()
        if position != end + 1:
            raise SystemExit("the store sent too few bytes")

    started = time.perf_counter()
    with ThreadPoolExecutor(CONNECTIONS) as fetchers:
        list(fetchers.map(fetch, *zip(*pieces, strict=True)))
    for path in {path for path, link, _ in pieces if link.size_bytes > _READ_BYTES}:
        with path.open("rb") as out:
            os.fsync(out)
    return {"seconds": time.perf_counter() - started}


def summary_remote(mission: str, path: str) -> Facts:
    """Summarise a stored recording through a presigned URL."""
    link = link_of(mission, path)
    started = time.perf_counter()
    source = CountingSource(HttpSource(link.url, size_bytes=link.size_bytes, name=path))
    summary = summarise(source)
    seconds = time.perf_counter() - started
    return {"seconds": seconds, "bytes_read": source.bytes_read, "messages": summary.message_count or 0}


def summary_raw(mission: str, path: str) -> Facts:
    """Request the ranges that a summary reads, eight at a time, by plain sockets, without processing them."""
    link = link_of(mission, path)
    ranges = _ranges_of_summary(link, path)
    url = urlsplit(link.url)
    head = f"GET {url.path}?{url.query} HTTP/1.1\r\nHost: {url.netloc}\r\n"

    def fetch(some: list[tuple[int, int]]) -> None:
        with (
            socket.create_connection((url.hostname or "", url.port or 80)) as connection,
            connection.makefile("rb") as answers,
        ):
            for offset, length in some:
                connection.sendall(f"{head}Range: bytes={offset}-{offset + length - 1}\r\n\r\n".encode())
                while answers.readline() != b"\r\n":
                    pass
                answers.read(length)

    started = time.perf_counter()
    with ThreadPoolExecutor(PARALLEL_READS) as fetchers:
        list(fetchers.map(fetch, [ranges[at::PARALLEL_READS] for at in range(PARALLEL_READS)]))
    return {"seconds": time.perf_counter() - started}


def _ranges_of_summary(link: DownloadLink, path: str) -> list[tuple[int, int]]:
    ranges = []

    class Noting(HttpSource):
        def read(self, offset: int, length: int) -> bytes:
            ranges.append((offset, length))
            return super().read(offset, length)

        def read_short(self, some: Iterable[tuple[int, int]]) -> Iterator[bytes]:
            for offset, length in some:
                yield self.read(offset, length)

    summarise(Noting(link.url, size_bytes=link.size_bytes, name=path))
    return ranges


if __name__ == "__main__":
    main((upload_ours, upload_raw, download_ours, download_raw, summary_remote, summary_raw))
