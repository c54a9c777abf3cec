"""The digest of an image, asked of a registry over HTTP."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart
from kleinkram.runner.executors.kubernetes.image_registry import ImageRegistry
from tests.http_server import Server

DIGEST = "sha256:" + "d" * 64


class Registry(BaseHTTPRequestHandler):
    """A registry with one image, of which it tells by a token."""

    needs_password = False

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  as its base calls it
        """Say nothing."""

    def do_HEAD(self) -> None:
        if self.headers.get("Authorization") != "Bearer the-token":
            host = self.headers["Host"]
            self.send_response(401)
            challenge = f'Bearer realm="http://{host}/token",service="registry",scope="repository:lab/slam:pull"'
            self.send_header("WWW-Authenticate", challenge)
        elif self.path == "/v2/lab/slam/manifests/1.0":
            self.send_response(200)
            self.send_header("Docker-Content-Digest", DIGEST)
        else:
            self.send_response(404)
        self.end_headers()

    def do_GET(self) -> None:
        assert "scope=repository%3Alab%2Fslam%3Apull" in self.path
        password = base64.b64encode(b"ada:secret").decode()
        if self.needs_password and self.headers.get("Authorization") != f"Basic {password}":
            self.send_response(401)
            self.end_headers()
            self.wfile.write(b'{"errors": []}')
            return
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b'{"token": "the-token"}')


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """The address of a registry, for which nobody has signed in."""
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    monkeypatch.setattr(Registry, "needs_password", False)
    server = Server(("127.0.0.1", 0), Registry)
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    yield f"127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_tag_becomes_a_digest(registry: str) -> None:
    image = ImageRegistry().pin(f"{registry}/lab/slam:1.0")
    assert (image.reference, image.digest) == (f"{registry}/lab/slam@{DIGEST}", DIGEST)


def test_a_name_with_a_digest_needs_no_registry() -> None:
    assert ImageRegistry().pin(f"slam@{DIGEST}").reference == f"docker.io/library/slam@{DIGEST}"


def test_the_password_of_docker_login_is_used(registry: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(Registry, "needs_password", True)
    with pytest.raises(CannotStart, match="401"):
        ImageRegistry().pin(f"{registry}/lab/slam:1.0")
    auths = {"auths": {registry: {"auth": base64.b64encode(b"ada:secret").decode()}}}
    (tmp_path / "config.json").write_text(json.dumps(auths))
    assert ImageRegistry().pin(f"{registry}/lab/slam:1.0").digest == DIGEST


@pytest.mark.parametrize("image", ["{}/lab/slam:2.0", "127.0.0.1:9/lab/slam:1.0", "{}/lab/slam@latest"])
def test_an_unknown_image_is_not_available(registry: str, image: str) -> None:
    with pytest.raises(CannotStart, match="The digest of the image") as caught:
        ImageRegistry().pin(image.format(registry))
    assert caught.value.ending.reason is EndReason.image_unavailable
