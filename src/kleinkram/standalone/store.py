"""Life-cycle of a private S3 store: SeaweedFS's `weed mini`, on loopback, with one identity and no services but S3.

Nothing of it ever listens beyond loopback: other machines come in through `door`. To whoever finds its other ports (any
page that a browser on this machine shows can look for them) master and filer have nothing to say by HTTP, and volumes
take words signed by a key that is made anew at each start, but for being read. The ports of gRPC, which no page speaks,
ask for nothing: who has an account on this machine is trusted as far as that. Ready means: bytes written came back.
"""

import hashlib
import json
import secrets
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kleinkram.standalone.child import Command, spawn
from kleinkram.standalone.s3 import StoreAccess

BUCKET = "kleinkram"
STOP_SIGNAL = signal.SIGTERM
_SERVICES = ("s3", "master", "volume", "filer", "admin")
# Not admin: weed's own worker looks for its gRPC port at the port plus 10000, whatever it is told.
_WITH_GRPC = ("s3", "master", "volume", "filer")
PORT_NAMES = (*_SERVICES, *(f"{service}_grpc" for service in _WITH_GRPC), "s3_tls")

# By these weed's own parts know each other. Reading a volume is left without: it takes an object's random cookie, which
# only the filer tells, and signing each range made the summaries of recordings a tenth slower.
_SIGNING_KEY = "WEED_JWT_SIGNING_KEY"
_CHUNK_MB = 16
# A loopback socket's path must fit into sockaddr_un.
_LONGEST_SOCKET_PATH = 100


@dataclass(frozen=True)
class StoreFolder:
    """Where one private store lives, its ports by `PORT_NAMES`, its only identity, and certificate and key if any.

    With a certificate it speaks TLS on `ports["s3_tls"]`, besides plain HTTP on `ports["s3"]`.
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
        """The store as this machine reaches it."""
        return StoreAccess(f"http://127.0.0.1:{self.ports['s3']}", self.access_key, self.secret_key)


def start(store: StoreFolder, *, extra: Sequence[str] = ()) -> "subprocess.Popen[bytes]":
    """Start the store on loopback, `extra` flags last. Returns before it is ready (see `s3.proves_ready`)."""
    objects = store.folder / "objects"
    objects.mkdir(parents=True, exist_ok=True)
    # weed writes its flags there and takes them for ours at the next start.
    (objects / "mini.options").unlink(missing_ok=True)
    ports = store.ports
    arguments = [
        "mini",
        f"-dir={objects}",
        "-ip=127.0.0.1",
        "-ip.bind=127.0.0.1",
        *(f"-{part}.port={ports[part]}" for part in _SERVICES),
        *(f"-{part}.port.grpc={ports[f'{part}_grpc']}" for part in _WITH_GRPC),
        "-s3.port.iceberg=0",
        "-s3.port.lance=0",
        f"-s3.config={_write_identities(store)}",
        "-s3.autoCreateBucket=false",
        f"-s3.localSocket={_socket(store, 's3')}",
        f"-filer.localSocket={_socket(store, 'filer')}",
        f"-filer.filerGroup={_group(store)}",
        # A part of an upload is one chunk. With the 4 MB that weed takes by itself, finding a range of a large object
        # costs the store half as much again: it reads the list of the object's chunks for each.
        f"-filer.maxMB={_CHUNK_MB}",
        "-volume.preStopSeconds=0",
        # With a resumed state the master may take itself for one of many after an election, and refuses every write
        # for 15 s (seaweedfs pull request 8529). What it would resume, the one volume server tells it at once.
        "-master.resumeState=false",
        "-master.telemetry=false",
        "-admin.ui=false",
        "-webdav=false",
        # Else the master signs, for anybody, what deletes an object, and tells a page whose name was made to mean this
        # machine how its collections are called, which one GET deletes. Its own parts speak gRPC.
        "-disableHttp=true",
    ]
    if store.tls:
        certificate, key = store.tls
        arguments += [f"-s3.port.https={ports['s3_tls']}", f"-s3.cert.file={certificate}", f"-s3.key.file={key}"]
    return spawn(_as_child(store, [*arguments, *extra]))


def _as_child(store: StoreFolder, arguments: list[str]) -> Command:
    return Command(
        arguments=[str(store.program), "-logtostderr=true", *arguments],
        data_dir=store.data_dir,
        log=store.log,
        # 140 MB less after a gigabyte than with 430MiB, for about a tenth more of its CPU time. GOGC=50 keeps the speed
        # that a memory limit alone would cost.
        environment={"GOMEMLIMIT": "295MiB", "GOGC": "50", _SIGNING_KEY: secrets.token_hex(32)},
        # Not where the caller stands: weed reads a security.toml from its working directory.
        directory=store.folder,
    )


def _write_identities(store: StoreFolder) -> Path:
    identity = {
        "name": "kleinkram",
        "credentials": [{"accessKey": store.access_key, "secretKey": store.secret_key}],
        "actions": ["Admin", "Read", "Write", "List", "Tagging"],
    }
    path = store.folder / "identities.json"
    path.touch(mode=0o600)
    path.write_text(json.dumps({"identities": [identity]}))
    return path


def _group(store: StoreFolder) -> str:
    """Return what the names of this store's collections begin with, the same at every start."""
    return "g" + hashlib.sha256(f"collections of {store.secret_key}".encode()).hexdigest()[:20]


def _socket(store: StoreFolder, name: str) -> Path:
    path = store.folder / f"{name}.sock"
    if len(str(path)) <= _LONGEST_SOCKET_PATH:
        return path
    return Path(tempfile.gettempdir()) / f"kleinkram-{name}-{store.ports['filer']}.sock"
