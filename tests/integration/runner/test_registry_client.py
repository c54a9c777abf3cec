"""The client of registries: tokens, redirects, broken connections, and damaged descriptions."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest

from kleinkram.runner.images.names import parse_image_name
from kleinkram.runner.images.registry import Layer, RegistryClient, RegistryFailure
from tests.http_server import QuietHandler, serving
from tests.integration.runner.registry_images import digest_of

LAYER = bytes(range(256)) * 4000
CONFIG = json.dumps({"architecture": "amd64", "os": "linux", "config": {"Cmd": ["ls"]}}).encode()
OCI = "application/vnd.oci.image"
_HOSTS = ("127.0.0.1", "127.0.0.2")


def manifest(**changes: object) -> bytes:
    layer = {"mediaType": f"{OCI}.layer.v1.tar+gzip", "digest": digest_of(LAYER), "size": len(LAYER)}
    config = {"mediaType": f"{OCI}.config.v1+json", "digest": digest_of(CONFIG), "size": len(CONFIG)}
    return json.dumps({"schemaVersion": 2, "config": config, "layers": [layer], **changes}).encode()


@dataclass
class PrivateRegistry:
    """A registry that wants a token for ada, sends blobs from another address, and breaks the first connection."""

    place: str = ""
    other_place: str = ""
    manifest: bytes = field(default_factory=manifest)
    kind: str = f"{OCI}.manifest.v1+json"
    requests: list[tuple[str, str | None]] = field(default_factory=list)
    breaks: int = 0
    sent_bytes: int = 100_000

    def answer(self, handler: QuietHandler) -> None:
        parts, known = urlsplit(handler.path), handler.headers.get("Authorization")
        self.requests.append((parts.path, known))
        if parts.path == "/token":
            ada = f"Basic {base64.b64encode(b'ada:secret').decode()}"
            scope = parse_qs(parts.query)["scope"]
            is_ada = known == ada and scope == ["repository:lab/slam:pull"]
            handler.send(200 if is_ada else 401, json.dumps({"token": "t"}).encode())
        elif parts.path.startswith("/elsewhere/"):
            self._send_blob(handler, CONFIG if parts.path.endswith(digest_of(CONFIG)) else LAYER)
        elif known != "Bearer t":
            realm = f'Bearer realm="http://{self.place}/token",service="registry"'
            handler.send(401, b"{}", {"WWW-Authenticate": realm})
        elif "/blobs/" in parts.path:
            place = f"http://{self.other_place}/elsewhere/{parts.path.rpartition('/')[2]}"
            handler.send(307, headers={"Location": place})
        else:
            handler.send(200, self.manifest, {"Content-Type": self.kind})

    def _send_blob(self, handler: QuietHandler, data: bytes) -> None:
        offset = int((handler.headers.get("Range") or "bytes=0-")[6:-1])
        if data is LAYER and self.breaks:
            self.breaks -= 1
            handler.send_response(206 if offset else 200)
            handler.send_header("Content-Length", str(len(data) - offset))
            handler.end_headers()
            handler.wfile.write(data[offset : offset + self.sent_bytes])
            handler.close_connection = True
            return
        handler.send(206 if offset else 200, data[offset:])


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[PrivateRegistry]:
    made = PrivateRegistry()

    class Handler(QuietHandler):
        protocol_version = "HTTP/1.1"
        timeout = 5

        def do_GET(self) -> None:
            made.answer(self)

    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    with ExitStack() as stack:
        made.place, made.other_place = (f"{host}:{stack.enter_context(serving(Handler, host))}" for host in _HOSTS)
        log_in(tmp_path, made.place, "ada:secret")
        yield made


def log_in(folder: Path, place: str, pair: str) -> None:
    known = {"auths": {place: {"auth": base64.b64encode(pair.encode()).decode()}}}
    (folder / "config.json").write_text(json.dumps(known))


def client_of(registry: PrivateRegistry) -> RegistryClient:
    return RegistryClient(parse_image_name(f"{registry.place}/lab/slam:1"), "amd64")


def test_an_image_is_resolved_with_the_credentials_of_the_user(registry: PrivateRegistry) -> None:
    image = client_of(registry).resolve()
    assert (image.digest, image.manifest_digest) == (digest_of(registry.manifest),) * 2
    assert image.config.command == ["ls"]
    assert image.layers == (Layer(digest_of(LAYER), len(LAYER)),)
    elsewhere = [known for path, known in registry.requests if path.startswith("/elsewhere/")]
    assert elsewhere == [None], "another address gets no token"


def test_a_broken_connection_is_resumed(registry: PrivateRegistry, tmp_path: Path) -> None:
    client, received = client_of(registry), list[int]()
    (layer,) = client.resolve().layers
    registry.breaks = 8
    client.fetch_layer(layer, tmp_path / "layer", received.append)
    assert (tmp_path / "layer").read_bytes() == LAYER
    assert sum(received) == len(LAYER), "nothing was fetched twice"
    registry.breaks, registry.sent_bytes = 100, 0
    with pytest.raises(RegistryFailure, match="broke off"):
        client.fetch_layer(layer, tmp_path / "layer", received.append)


def test_a_layer_of_another_size_is_refused(registry: PrivateRegistry, tmp_path: Path) -> None:
    client = client_of(registry)
    client.resolve()
    with pytest.raises(RegistryFailure, match="sent something else"):
        client.fetch_layer(Layer(digest_of(LAYER), 1000), tmp_path / "layer", lambda _: None)


def test_wrong_credentials_say_how_to_log_in(registry: PrivateRegistry, tmp_path: Path) -> None:
    log_in(tmp_path, registry.place, "ada:wrong")
    with pytest.raises(RegistryFailure, match="docker login"):
        client_of(registry).resolve()


@pytest.mark.parametrize(
    ("data", "kind", "reason"),
    [
        (b"<html>", f"{OCI}.manifest.v1+json", "damaged description"),
        (manifest(layers=[{"digest": "sha256:../../x", "size": 1}]), f"{OCI}.manifest.v1+json", "layers.0.digest"),
        (
            manifest(layers=[{"digest": digest_of(b""), "size": 1, "mediaType": "application/x-exe"}]),
            f"{OCI}.manifest.v1+json",
            "a layer of an unknown kind",
        ),
        (manifest(), "application/vnd.cncf.helm.config.v1+json", "no image of containers"),
        (b" " * (4 * 2**20 + 1), f"{OCI}.manifest.v1+json", "a description of more than"),
    ],
)
def test_descriptions_that_are_not_images_are_refused(
    registry: PrivateRegistry, data: bytes, kind: str, reason: str
) -> None:
    registry.manifest, registry.kind = data, kind
    with pytest.raises(RegistryFailure, match=reason):
        client_of(registry).resolve()
