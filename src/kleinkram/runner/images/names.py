"""Names of images, which of them a runner may use, and the credentials of their registries."""

import base64
import binascii
import enum
import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

HUB = "docker.io"
# The name of Docker's own registry in files of credentials.
_HUB_CREDENTIALS = "https://index.docker.io/v1/"
_CREDENTIALS_TIMEOUT_S = 20


class Pull(str, enum.Enum):
    """When images are pulled. For a name with a digest, `always` means `missing`."""

    always = "always"
    missing = "missing"
    never = "never"


class ImageNotAllowed(Exception):
    """A runner may not use an image. The text is a sentence."""


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
    registry, path = (first, others) if has_registry else (HUB, rest)
    path, _, tag = path.partition(":")
    if registry == HUB and "/" not in path:
        path = f"library/{path}"
    return ImageName(f"{registry}/{path}", tag or "latest", digest)


def is_allowed(name: ImageName, allowed: Sequence[str]) -> bool:
    """Whether an image comes from one of the registries or namespaces, such as `ghcr.io` or `ghcr.io/lab`."""
    return any(name.repository == prefix or name.repository.startswith(prefix.rstrip("/") + "/") for prefix in allowed)


def check_allowed(text: str, allowed: Sequence[str] | None) -> ImageName:
    """Return the full name of an image that a runner may use. `allowed`: None for all.

    Raises:
        ImageNotAllowed: it comes from elsewhere.
    """
    name = parse_image_name(text)
    if allowed is not None and not is_allowed(name, allowed):
        choices = ", ".join(allowed) or "none"
        raise ImageNotAllowed(f"This runner may not use {name.repository}; it may use images of: {choices}.")
    return name


def credentials_for(registry: str) -> dict[str, str] | None:
    """Return the credentials of a registry, with the names that engines use, from the file of `docker login`, if any.

    They are `username` and `password`, or `identitytoken`; and `serveraddress`.
    """
    directory = Path(os.environ.get("DOCKER_CONFIG") or Path.home() / ".docker")
    try:
        config = json.loads((directory / "config.json").read_text())
    except (OSError, ValueError):
        return None
    address = _HUB_CREDENTIALS if registry == HUB else registry
    helper = config.get("credHelpers", {}).get(registry) or config.get("credsStore")
    known = _from_helper(helper, address) if helper else _from_file(config.get("auths", {}).get(address, {}))
    return None if known is None else {**known, "serveraddress": address}


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
