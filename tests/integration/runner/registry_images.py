"""Images in a registry for tests, made without an engine."""

from __future__ import annotations

import functools
import gzip
import hashlib
import io
import json
import platform
import tarfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import urllib3
import zstandard

from tests.integration.runner.engines import Registry

ARCHITECTURE = {"x86_64": "amd64", "aarch64": "arm64"}[platform.machine()]
_OCI = "application/vnd.oci.image"
_http = urllib3.PoolManager()


def digest_of(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


@functools.cache
def gzipped(tar: bytes) -> bytes:
    return gzip.compress(tar, compresslevel=1, mtime=0)


def zstandard_of(tar: bytes) -> bytes:
    return zstandard.compress(tar)


def layer_of(*entries: tarfile.TarInfo | tuple[tarfile.TarInfo, bytes]) -> bytes:
    """Return a tar of these entries, whatever they are."""
    with io.BytesIO() as stream, tarfile.open(fileobj=stream, mode="w") as tar:
        for entry in entries:
            info, data = entry if isinstance(entry, tuple) else (entry, b"")
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
        tar.close()
        return stream.getvalue()


def entry(name: str, kind: bytes = tarfile.REGTYPE, target: str = "", mode: int = 0o644) -> tarfile.TarInfo:
    made = tarfile.TarInfo(name)
    made.type, made.linkname, made.mode = kind, target, mode
    return made


def _unpacked(layer: bytes) -> bytes:
    """Return the tar of a layer; what is damaged, as it is."""
    try:
        return gzip.decompress(layer) if layer[:2] == b"\x1f\x8b" else zstandard.ZstdDecompressor().decompress(layer)
    except (OSError, EOFError, zlib.error, zstandard.ZstdError):
        return layer


@dataclass
class RegistryImages:
    """Puts images into a registry."""

    registry: Registry

    def push(
        self,
        name: str,
        layers: Sequence[bytes],
        *,
        architectures: Sequence[str] = (ARCHITECTURE,),
        tag: str = "latest",
        config: Mapping[str, object] | None = None,
    ) -> str:
        """Put an image into the registry, with an index if it is for several architectures; return its name."""
        self._push(name, layers, architectures, tag, config or {})
        return f"{self.registry.place}/{name}:{tag}"

    def _push(
        self, name: str, layers: Sequence[bytes], architectures: Sequence[str], tag: str, config: Mapping[str, object]
    ) -> None:
        described = []
        for layer in layers:
            kind = "+gzip" if layer[:2] == b"\x1f\x8b" else "+zstd" if layer[:4] == b"\x28\xb5\x2f\xfd" else ""
            described.append(self._descriptor(self._put_blob(name, layer), layer, f"{_OCI}.layer.v1.tar{kind}"))
        manifests = []
        for architecture in architectures:
            files = {"type": "layers", "diff_ids": [digest_of(_unpacked(layer)) for layer in layers]}
            facts = {"architecture": architecture, "os": "linux", "config": config, "rootfs": files}
            text = json.dumps(facts).encode()
            manifest = {
                "schemaVersion": 2,
                "mediaType": f"{_OCI}.manifest.v1+json",
                "config": self._descriptor(self._put_blob(name, text), text, f"{_OCI}.config.v1+json"),
                "layers": described,
            }
            data = json.dumps(manifest).encode()
            self._put_manifest(name, digest_of(data), data, manifest["mediaType"])
            about = self._descriptor(digest_of(data), data, str(manifest["mediaType"]))
            manifests.append({**about, "platform": {"architecture": architecture, "os": "linux"}})
            if len(architectures) == 1:
                self._put_manifest(name, tag, data, manifest["mediaType"])
        if len(architectures) > 1:
            index = {"schemaVersion": 2, "mediaType": f"{_OCI}.index.v1+json", "manifests": manifests}
            self._put_manifest(name, tag, json.dumps(index).encode(), index["mediaType"])

    def _descriptor(self, digest: str, data: bytes, kind: str) -> dict[str, object]:
        return {"mediaType": kind, "digest": digest, "size": len(data)}

    def _put_blob(self, name: str, data: bytes) -> str:
        started = _http.request("POST", f"http://{self.registry.place}/v2/{name}/blobs/uploads/")
        place = started.headers["Location"]
        digest = digest_of(data)
        put = _http.request("PUT", f"{place}&digest={digest}", body=data)
        assert put.status == 201, put.data
        return digest

    def _put_manifest(self, name: str, reference: str, data: bytes, kind: object) -> None:
        url = f"http://{self.registry.place}/v2/{name}/manifests/{reference}"
        put = _http.request("PUT", url, body=data, headers={"Content-Type": str(kind)})
        assert put.status == 201, put.data
