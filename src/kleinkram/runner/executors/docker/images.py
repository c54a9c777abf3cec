"""Images: their names, which of them a runner may use, and the credentials of registries."""

import base64
import binascii
import enum
import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart, PinnedImage
from kleinkram.runner.executors.docker.client import DockerClient, EngineError, EngineUnavailable, ImageInfo
from kleinkram.runner.executors.local import cannot_start

_HUB = "docker.io"
# The name of Docker's own registry in files of credentials.
_HUB_CREDENTIALS = "https://index.docker.io/v1/"
_CREDENTIALS_TIMEOUT_S = 20


class Pull(str, enum.Enum):
    """When images are pulled. For a name with a digest, `always` means `missing`."""

    always = "always"
    missing = "missing"
    never = "never"


class ImageName(NamedTuple):
    """A full image name: `repository` includes the registry; `digest` is empty where the name has none."""

    repository: str
    tag: str
    digest: str


def parse_image_name(text: str) -> ImageName:
    """Return the full name: `debian` is `docker.io/library/debian:latest`.

    Source: github.com/distribution/reference, normalize.go.
    """
    rest, _, digest = text.partition("@")
    first, slash, others = rest.partition("/")
    has_registry = bool(slash) and ("." in first or ":" in first or first == "localhost")
    registry, path = (first, others) if has_registry else (_HUB, rest)
    path, _, tag = path.partition(":")
    if registry == _HUB and "/" not in path:
        path = f"library/{path}"
    return ImageName(f"{registry}/{path}", tag or "latest", digest)


def is_allowed(name: ImageName, allowed: Sequence[str]) -> bool:
    """Whether an image comes from one of the registries or namespaces, such as `ghcr.io` or `ghcr.io/lab`."""
    return any(name.repository == prefix or name.repository.startswith(prefix.rstrip("/") + "/") for prefix in allowed)


class Images:
    """The images that a runner may use. `allowed`: None for all."""

    def __init__(self, client: DockerClient, architecture: str, *, pull: Pull, allowed: Sequence[str] | None) -> None:
        self._client = client
        self._architecture = architecture
        self._pull = pull
        self._allowed = allowed

    def prepare(self, text: str) -> PinnedImage:
        """Pull an image where that is needed and allowed.

        Raises:
            CannotStart: it is not allowed, not available, or for another architecture.
        """
        name = parse_image_name(text)
        if self._allowed is not None and not is_allowed(name, self._allowed):
            choices = ", ".join(self._allowed) or "none"
            raise _unavailable(f"This runner may not use {name.repository}; it may use images of: {choices}.")
        try:
            image = self._find(text, name)
            is_outdated = self._pull is Pull.always and not name.digest
            if (image is None or is_outdated) and self._pull is not Pull.never:
                self._fetch(text, name)
                image = self._find(text, name)
        except EngineUnavailable as error:
            raise _unavailable(f"{error}.") from error
        if image is None:
            raise _unavailable(f"The image {text} is not on this runner, which does not pull images.")
        if image.architecture != self._architecture:
            message = f"The image {text} is for {image.architecture}; this runner is {self._architecture}."
            raise cannot_start(message)
        return PinnedImage(reference=image.id, digest=_digest_of(image, name))

    def _find(self, text: str, name: ImageName) -> ImageInfo | None:
        image = self._client.find_image(text)
        if image is None and name.digest:
            # The digest of an image that was built here is its id.
            return self._client.find_image(name.digest)
        return image

    def _fetch(self, text: str, name: ImageName) -> None:
        registry = name.repository.partition("/")[0]
        credentials = credentials_for(registry)
        try:
            tag = name.digest or name.tag
            self._client.pull(name.repository, tag, architecture=self._architecture, credentials=credentials)
        except EngineError as error:
            raise _unavailable(f"The image {text} cannot be pulled from {registry}: {error}.") from error


def credentials_for(registry: str) -> str | None:
    """Return the credentials of a registry, as engines send them, from the file of `docker login`; None without."""
    directory = Path(os.environ.get("DOCKER_CONFIG") or Path.home() / ".docker")
    try:
        config = json.loads((directory / "config.json").read_text())
    except (OSError, ValueError):
        return None
    address = _HUB_CREDENTIALS if registry == _HUB else registry
    helper = config.get("credHelpers", {}).get(registry) or config.get("credsStore")
    known = _from_helper(helper, address) if helper else _from_file(config.get("auths", {}).get(address, {}))
    if known is None:
        return None
    return base64.urlsafe_b64encode(json.dumps({**known, "serveraddress": address}).encode()).decode()


def _from_file(entry: dict[str, str]) -> dict[str, str] | None:
    if "identitytoken" in entry:
        return {"identitytoken": entry["identitytoken"]}
    try:
        user, colon, password = base64.b64decode(entry.get("auth", "")).decode().partition(":")
    except (binascii.Error, UnicodeDecodeError):
        return None
    return {"username": user, "password": password} if colon else None


def _from_helper(helper: str, address: str) -> dict[str, str] | None:
    command = [f"docker-credential-{helper}", "get"]
    try:
        done = subprocess.run(
            command, input=address, capture_output=True, text=True, check=True, timeout=_CREDENTIALS_TIMEOUT_S
        )
        answer = json.loads(done.stdout)
        user, secret = answer["Username"], answer["Secret"]
    except (OSError, subprocess.SubprocessError, ValueError, KeyError):
        return None
    return {"identitytoken": secret} if user == "<token>" else {"username": user, "password": secret}


def _digest_of(image: ImageInfo, name: ImageName) -> str:
    """Return the digest in the registry of the name; the id where the image is in no registry."""
    if name.digest:
        return name.digest
    digests = [full.partition("@")[2] for full in image.digests if parse_image_name(full).repository == name.repository]
    return digests[-1] if digests else image.id


def _unavailable(message: str) -> CannotStart:
    return cannot_start(message, EndReason.image_unavailable)
