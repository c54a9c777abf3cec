"""The digest of an image, asked of a registry over HTTP."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart
from kleinkram.runner.executors.kubernetes.image_registry import pin_image
from tests.http_server import QuietHandler, serving

MANIFEST = b'{"schemaVersion": 2}'
DIGEST = f"sha256:{hashlib.sha256(MANIFEST).hexdigest()}"


class Registry(QuietHandler):
    """A registry with one image, of which it tells by a token."""

    needs_password = False

    def do_GET(self) -> None:
        if self.path.startswith("/token"):
            assert "scope=repository%3Alab%2Fslam%3Apull" in self.path
            password = base64.b64encode(b"ada:secret").decode()
            is_refused = self.needs_password and self.headers.get("Authorization") != f"Basic {password}"
            self.send(401 if is_refused else 200, b'{"errors": []}' if is_refused else b'{"token": "the-token"}')
        elif self.headers.get("Authorization") != "Bearer the-token":
            host = self.headers["Host"]
            challenge = f'Bearer realm="http://{host}/token",service="registry",scope="repository:lab/slam:pull"'
            self.send(401, b"{}", {"WWW-Authenticate": challenge})
        elif self.path == "/v2/lab/slam/manifests/1.0":
            self.send(200, MANIFEST, {"Content-Type": "application/vnd.oci.image.manifest.v1+json"})
        else:
            self.send(404, b"{}")


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """The address of a registry, for which nobody has signed in."""
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    monkeypatch.setattr(Registry, "needs_password", False)
    with serving(Registry) as port:
        yield f"127.0.0.1:{port}"


def test_a_tag_becomes_a_digest(registry: str) -> None:
    image = pin_image(f"{registry}/lab/slam:1.0")
    assert (image.reference, image.digest) == (f"{registry}/lab/slam@{DIGEST}", DIGEST)


def test_a_name_with_a_digest_needs_no_registry() -> None:
    assert pin_image(f"slam@{DIGEST}").reference == f"docker.io/library/slam@{DIGEST}"


def test_the_password_of_docker_login_is_used(registry: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(Registry, "needs_password", True)
    with pytest.raises(CannotStart, match="log in there"):
        pin_image(f"{registry}/lab/slam:1.0")
    auths = {"auths": {registry: {"auth": base64.b64encode(b"ada:secret").decode()}}}
    (tmp_path / "config.json").write_text(json.dumps(auths))
    assert pin_image(f"{registry}/lab/slam:1.0").digest == DIGEST


@pytest.mark.parametrize("image", ["{}/lab/slam:2.0", "127.0.0.1:9/lab/slam:1.0", "{}/lab/slam@latest"])
def test_an_unknown_image_is_not_available(registry: str, image: str) -> None:
    with pytest.raises(CannotStart, match="The digest of the image") as caught:
        pin_image(image.format(registry))
    assert caught.value.ending.reason is EndReason.image_unavailable
