"""Names of images, which of them a runner may fetch, and the credentials for that."""

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
from kleinkram.runner.docker.engine import Engine, EngineAway, Image, Refused
from kleinkram.runner.work import CannotStart, Ending, ImagePinned

_HUB = "docker.io"
# What Docker's own registry is called where credentials are kept.
_HUB_CREDENTIALS = "https://index.docker.io/v1/"
_CREDENTIALS_TIMEOUT_S = 20


class Pull(str, enum.Enum):
    """When images are fetched. One that is named by its digest is what it is: `always` then means `missing`."""

    always = "always"
    missing = "missing"
    never = "never"


class Name(NamedTuple):
    """An image's name in full: `place` is registry and repository; `digest` is empty where the name has none."""

    place: str
    tag: str
    digest: str


def read_name(text: str) -> Name:
    """Return a name in full, as engines understand it: `debian` is `docker.io/library/debian:latest`.

    Source: github.com/distribution/reference, normalize.go.
    """
    rest, _, digest = text.partition("@")
    first, slash, others = rest.partition("/")
    has_registry = bool(slash) and ("." in first or ":" in first or first == "localhost")
    registry, path = (first, others) if has_registry else (_HUB, rest)
    path, _, tag = path.partition(":")
    if registry == _HUB and "/" not in path:
        path = f"library/{path}"
    return Name(f"{registry}/{path}", tag or "latest", digest)


def is_allowed(name: Name, allowed: Sequence[str]) -> bool:
    """Whether an image is of one of the registries or folders of registries, such as `ghcr.io` or `ghcr.io/lab`."""
    return any(name.place == each or name.place.startswith(each.rstrip("/") + "/") for each in allowed)


class Images:
    """The images of one architecture that a runner may use. `allowed`: None for all."""

    def __init__(self, engine: Engine, architecture: str, *, pull: Pull, allowed: Sequence[str] | None) -> None:
        self._engine = engine
        self._architecture = architecture
        self._pull = pull
        self._allowed = allowed

    def prepare(self, text: str) -> ImagePinned:
        """Have an image here, fetched where that is needed and allowed.

        Raises:
            CannotStart: it is not allowed, cannot be had, or is for another architecture.
        """
        name = read_name(text)
        if self._allowed is not None and not is_allowed(name, self._allowed):
            choices = ", ".join(self._allowed) or "none"
            raise _unavailable(f"This runner may not use {name.place}; it may use images of: {choices}.")
        try:
            found = self._find(text, name)
            is_wanted = found is None or (self._pull is Pull.always and not name.digest)
            if is_wanted and self._pull is not Pull.never:
                self._fetch(text, name)
                found = self._find(text, name)
        except EngineAway as error:
            raise _unavailable(f"{error}.") from error
        if found is None:
            raise _unavailable(f"The image {text} is not on this runner, and it fetches none.")
        if found.architecture != self._architecture:
            message = f"The image {text} is for {found.architecture}; this runner is {self._architecture}."
            raise CannotStart(Ending(EndReason.not_possible, message))
        return ImagePinned(reference=found.id, digest=_digest_of(found, name))

    def _find(self, text: str, name: Name) -> Image | None:
        found = self._engine.find_image(text)
        if found is None and name.digest:
            # One that was built here is in no registry, and its id is its digest.
            return self._engine.find_image(name.digest)
        return found

    def _fetch(self, text: str, name: Name) -> None:
        registry = name.place.partition("/")[0]
        credentials = credentials_for(registry)
        try:
            tag = name.digest or name.tag
            self._engine.pull(name.place, tag, architecture=self._architecture, credentials=credentials)
        except Refused as error:
            raise _unavailable(f"The image {text} cannot be had from {registry}: {error}.") from error


def credentials_for(registry: str) -> str | None:
    """Return what an engine is to send to a registry, from the same file as `docker login` writes; None without."""
    folder = Path(os.environ.get("DOCKER_CONFIG") or Path.home() / ".docker")
    try:
        said = json.loads((folder / "config.json").read_text())
    except (OSError, ValueError):
        return None
    address = _HUB_CREDENTIALS if registry == _HUB else registry
    helper = said.get("credHelpers", {}).get(registry) or said.get("credsStore")
    known = _from_helper(helper, address) if helper else _from_file(said.get("auths", {}).get(address, {}))
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
        said = json.loads(done.stdout)
        user, secret = said["Username"], said["Secret"]
    except (OSError, subprocess.SubprocessError, ValueError, KeyError):
        return None
    return {"identitytoken": secret} if user == "<token>" else {"username": user, "password": secret}


def _digest_of(image: Image, name: Name) -> str:
    """The digest by which others get the same image; its id where it is in no registry."""
    if name.digest:
        return name.digest
    same = [each.partition("@")[2] for each in image.digests if read_name(each).place == name.place]
    return same[-1] if same else image.id


def _unavailable(message: str) -> CannotStart:
    return CannotStart(Ending(EndReason.image_unavailable, message))
