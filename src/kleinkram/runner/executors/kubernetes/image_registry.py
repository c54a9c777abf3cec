"""Finds the digests of images in their registries, since a cluster reports them only once a pod runs.

Source: the OCI Distribution Specification, "Pulling manifests"; distribution's token authentication.
"""

import base64
import json
import os
import re
from http import HTTPStatus
from urllib.parse import urlencode

import urllib3
from pydantic import BaseModel, ValidationError

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart, Ending, PinnedImage
from kleinkram.runner.executors.docker.client import ImageName, credentials_for, parse_image_name

_HUB, _HUB_ADDRESS = "docker.io", "registry-1.docker.io"
_TIMEOUT = urllib3.Timeout(connect=10, read=30)
_MANIFESTS = (
    "application/vnd.oci.image.index.v1+json",
    "application/vnd.docker.distribution.manifest.list.v2+json",
    "application/vnd.oci.image.manifest.v1+json",
    "application/vnd.docker.distribution.manifest.v2+json",
)
_CHALLENGE = re.compile(r'(\w+)="([^"]*)"')
_DIGEST = re.compile(r"sha256:[0-9a-f]{64}")


class _Token(BaseModel):
    token: str = ""
    access_token: str = ""


class _Credentials(BaseModel):
    username: str = ""
    password: str = ""
    identitytoken: str = ""


class ImageRegistry:
    """Asks registries, with the credentials of `docker login` where this user has some."""

    def __init__(self) -> None:
        authorities = os.environ.get("SSL_CERT_FILE")
        self._http = urllib3.PoolManager(retries=urllib3.Retry(2, redirect=3), timeout=_TIMEOUT, ca_certs=authorities)

    def pin(self, text: str) -> PinnedImage:
        """Return an image by its digest, which is asked for where the name has none.

        Raises:
            CannotStart: its registry does not tell.
        """
        name = parse_image_name(text)
        digest = name.digest or self._find_digest(text, name)
        if not _DIGEST.fullmatch(digest):
            raise _unavailable(text, f"{digest!r} is no digest")
        return PinnedImage(f"{name.repository}@{digest}", digest)

    def _find_digest(self, text: str, name: ImageName) -> str:
        registry, _, path = name.repository.partition("/")
        address = _HUB_ADDRESS if registry == _HUB else registry
        scheme = "http" if address.partition(":")[0] in {"localhost", "127.0.0.1"} else "https"
        url = f"{scheme}://{address}/v2/{path}/manifests/{name.tag}"
        headers = {"Accept": ", ".join(_MANIFESTS)}
        try:
            answer = self._http.request("HEAD", url, headers=headers)
            if answer.status == HTTPStatus.UNAUTHORIZED:
                authorization = self._authorize(answer.headers.get("WWW-Authenticate", ""), registry)
                answer = self._http.request("HEAD", url, headers={**headers, "Authorization": authorization})
        except (urllib3.exceptions.HTTPError, ValidationError) as error:
            raise _unavailable(text, f"its registry does not answer: {error}") from error
        digest = answer.headers.get("Docker-Content-Digest")
        if answer.status != HTTPStatus.OK or digest is None:
            raise _unavailable(text, f"its registry answers with the HTTP status {answer.status}")
        return digest

    def _authorize(self, challenge: str, registry: str) -> str:
        """Return the value of the header that a registry asks for."""
        kind, _, rest = challenge.partition(" ")
        basic = _basic(registry)
        if kind.lower() != "bearer":
            return basic
        parameters = dict(_CHALLENGE.findall(rest))
        realm = parameters.pop("realm", "")
        headers = {"Authorization": basic} if basic else {}
        answer = self._http.request("GET", f"{realm}?{urlencode(parameters)}", headers=headers)
        token = _Token.model_validate_json(answer.data)
        return f"Bearer {token.token or token.access_token}"


def _basic(registry: str) -> str:
    encoded = credentials_for(registry)
    if encoded is None:
        return ""
    known = _Credentials.model_validate(json.loads(base64.urlsafe_b64decode(encoded)))
    pair = f"{known.username or '<token>'}:{known.password or known.identitytoken}"
    return f"Basic {base64.b64encode(pair.encode()).decode()}"


def _unavailable(text: str, reason: str) -> CannotStart:
    message = (
        f"The digest of the image {text} is not known: {reason}. Name it with its digest (@sha256:…), or try again."
    )
    return CannotStart(Ending(EndReason.image_unavailable, message))
