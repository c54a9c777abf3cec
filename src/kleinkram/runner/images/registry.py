"""Client for registries of images: resolves names to digests, and fetches what they stand for, verified.

Source: github.com/opencontainers/distribution-spec, spec.md; github.com/opencontainers/image-spec, manifest.md and
image-index.md; distribution.github.io/distribution/spec/auth/token.
"""

import base64
import hashlib
import ipaddress
import json
import re
import ssl
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, NamedTuple, TypeVar
from urllib.parse import urlencode, urlsplit

import urllib3
from pydantic import BaseModel, Field, ValidationError

from kleinkram.contract.problems import first_problem
from kleinkram.runner.images.names import HUB, ImageName, credentials_for

_HUB_HOST = "registry-1.docker.io"
_TIMEOUT = urllib3.Timeout(connect=20, read=60)
_RETRIES = urllib3.Retry(total=4, redirect=10, backoff_factor=0.5, status_forcelist=(429, 500, 502, 503, 504))
_ATTEMPTS = 5
_PIECE_BYTES = 2**20
_DOCUMENT_BYTES = 4 * 2**20
_LAYERS = 500
_INDEXES = {"application/vnd.oci.image.index.v1+json", "application/vnd.docker.distribution.manifest.list.v2+json"}
_MANIFESTS = {"application/vnd.oci.image.manifest.v1+json", "application/vnd.docker.distribution.manifest.v2+json"}
_LAYER_TYPES = re.compile(
    r"application/vnd\.(oci\.image\.layer\.v1|docker\.image\.rootfs\.diff)\.tar([.+](gzip|zstd))?"
)
_CHALLENGE = re.compile(r'(\w+)="([^"]*)"')

_Document = TypeVar("_Document", bound=BaseModel)
Digest = Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]


class _Platform(BaseModel):
    architecture: str = ""
    os: str = ""


class _Descriptor(BaseModel):
    digest: Digest
    size: Annotated[int, Field(ge=0, lt=2**50)]
    media_type: Annotated[str, Field(alias="mediaType")] = ""
    platform: _Platform | None = None


class _ImageIndex(BaseModel):
    manifests: list[_Descriptor]


class _ImageManifest(BaseModel):
    config: _Descriptor
    layers: Annotated[list[_Descriptor], Field(max_length=_LAYERS)]


class ImageConfig(BaseModel):
    """What an image says about how it is run."""

    environment: Annotated[list[str] | None, Field(alias="Env")] = None
    entrypoint: Annotated[list[str] | None, Field(alias="Entrypoint")] = None
    command: Annotated[list[str] | None, Field(alias="Cmd")] = None
    directory: Annotated[str | None, Field(alias="WorkingDir")] = None
    volumes: Annotated[dict[str, object] | None, Field(alias="Volumes")] = None


class _ConfigFile(BaseModel):
    architecture: str = ""
    os: str = "linux"
    config: ImageConfig | None = None


class Layer(NamedTuple):
    """A layer in a registry."""

    digest: str
    size_bytes: int


class RegistryImage(NamedTuple):
    """An image for one architecture. `digest` is that of its name; `manifest_digest` that for this architecture."""

    digest: str
    manifest_digest: str
    config: ImageConfig
    layers: tuple[Layer, ...]


class RegistryFailure(Exception):
    """An image cannot be had from its registry. The text is a sentence."""


class OtherArchitecture(RegistryFailure):
    """An image is for another architecture."""


class RegistryClient:
    """Reads one repository of a registry. For one thread."""

    def __init__(self, name: ImageName, architecture: str) -> None:
        self._name = name
        self._architecture = architecture
        self._registry, _, self._path = name.repository.partition("/")
        self._host = _HUB_HOST if self._registry == HUB else self._registry
        self._is_loopback = is_loopback(self._host)
        self._scheme = "https"
        self._authorization: dict[str, str] = {}

    def resolve(self) -> RegistryImage:
        """Return the image of the name.

        Raises:
            RegistryFailure: the registry does not answer or has no such image, or what it has is not usable.
        """
        data, kind = self._get_manifest(self._name.digest or self._name.tag)
        digest = _digest_of(data)
        manifest_digest = digest
        if kind in _INDEXES:
            manifest_digest = self._choose(_parse(_ImageIndex, data, self._name).manifests)
            data, kind = self._get_manifest(manifest_digest)
        if kind not in _MANIFESTS:
            raise RegistryFailure(f"{self._label} is no image of containers ({kind or 'without a type'}).")
        manifest = _parse(_ImageManifest, data, self._name)
        for layer in manifest.layers:
            if not _LAYER_TYPES.fullmatch(layer.media_type):
                raise RegistryFailure(f"{self._label} has a layer of an unknown kind: {layer.media_type}.")
        config = _parse(_ConfigFile, self._get_document(manifest.config), self._name)
        if (config.os, config.architecture) != ("linux", self._architecture):
            raise self._other_architecture({f"{config.os}/{config.architecture}"})
        layers = tuple(Layer(layer.digest, layer.size) for layer in manifest.layers)
        return RegistryImage(digest, manifest_digest, config.config or ImageConfig(), layers)

    def find_digest(self) -> str:
        """Return the digest of the name, which may stand for images of several architectures. Raises as `resolve`."""
        return _digest_of(self._get_manifest(self._name.tag)[0])

    def fetch_layer(self, layer: Layer, path: Path, check: Callable[[int], None]) -> None:
        """Write a layer to a file, verified; a broken connection is resumed. `check` gets the size of each piece.

        Raises:
            RegistryFailure: it is not available, or differs from its digest.
            OSError: the disk is full.
        """
        digest = hashlib.sha256()
        received = 0
        failure: Exception | None = None
        with path.open("wb") as stream:
            attempts = 0
            while received < layer.size_bytes and attempts < _ATTEMPTS:
                attempts += 1
                try:
                    answer = self._open(f"blobs/{layer.digest}", {"Range": f"bytes={received}-"} if received else {})
                    if received and answer.status != 206:
                        digest, received = hashlib.sha256(), 0
                        stream.seek(0)
                        stream.truncate()
                    for piece in answer.stream(_PIECE_BYTES, decode_content=False):
                        received += len(piece)
                        if received > layer.size_bytes:
                            break
                        check(len(piece))
                        digest.update(piece)
                        stream.write(piece)
                        attempts = 0
                except urllib3.exceptions.HTTPError as error:
                    failure = error
        if received < layer.size_bytes:
            raise RegistryFailure(f"The connection to {self._registry} broke off: {failure or 'data are missing'}.")
        if received > layer.size_bytes or f"sha256:{digest.hexdigest()}" != layer.digest:
            raise self._damaged(layer.digest)

    def _choose(self, manifests: list[_Descriptor]) -> str:
        platforms = {
            f"{item.platform.os}/{item.platform.architecture}": item.digest
            for item in reversed(manifests)
            if item.platform is not None
        }
        try:
            return platforms[f"linux/{self._architecture}"]
        except KeyError:
            raise self._other_architecture({name for name in platforms if "unknown" not in name}) from None

    def _other_architecture(self, platforms: set[str]) -> OtherArchitecture:
        kinds = ", ".join(sorted(name.removeprefix("linux/") for name in platforms)) or "no architecture"
        return OtherArchitecture(f"{self._label} is for {kinds}; this runner is {self._architecture}.")

    def _get_manifest(self, reference: str) -> tuple[bytes, str]:
        data, headers = self._read(f"manifests/{reference}", {"Accept": ", ".join(sorted(_MANIFESTS | _INDEXES))})
        if reference.startswith("sha256:") and _digest_of(data) != reference:
            raise self._damaged(reference)
        kind = headers.get("Content-Type", "").partition(";")[0].strip()
        return data, kind

    def _get_document(self, descriptor: _Descriptor) -> bytes:
        data, _ = self._read(f"blobs/{descriptor.digest}", {})
        if _digest_of(data) != descriptor.digest:
            raise self._damaged(descriptor.digest)
        return data

    def _damaged(self, digest: str) -> RegistryFailure:
        return RegistryFailure(f"{self._registry} sent something else than {self._label}: it is not {digest}.")

    @property
    def _label(self) -> str:
        tail = f"@{self._name.digest}" if self._name.digest else f":{self._name.tag}"
        return f"The image {self._name.repository}{tail}"

    def _read(self, path: str, headers: Mapping[str, str]) -> tuple[bytes, Mapping[str, str]]:
        try:
            answer = self._open(path, headers)
            data = answer.read(_DOCUMENT_BYTES + 1, decode_content=True)
        except urllib3.exceptions.HTTPError as error:
            raise self._away(error) from error
        answer.close()
        if len(data) > _DOCUMENT_BYTES:
            raise RegistryFailure(f"{self._label} has a description of more than {_DOCUMENT_BYTES} bytes.")
        return data, answer.headers

    def _open(self, path: str, headers: Mapping[str, str]) -> urllib3.BaseHTTPResponse:
        """Send a request, with a token where the registry asks for one. Raises HTTPError, RegistryFailure."""
        answer = self._request(path, headers)
        if answer.status == 401 and (challenge := answer.headers.get("WWW-Authenticate")):
            self._authorization = self._answer_to(challenge)
            answer = self._request(path, headers)
        if answer.status < 300:
            return answer
        reason = _message(answer.read(_DOCUMENT_BYTES)) or answer.reason
        answer.close()
        if answer.status == 404:
            raise RegistryFailure(f"{self._label} does not exist: {reason}.")
        if answer.status in (401, 403):
            hint = "log in there with 'docker login', 'podman login' or 'apptainer registry login' as the runner's user"
            raise RegistryFailure(f"{self._registry} refuses {self._label[4:]} to this runner ({reason}); {hint}.")
        raise RegistryFailure(f"{self._label} cannot be pulled from {self._registry}: {answer.status} {reason}.")

    def _request(self, path: str, headers: Mapping[str, str]) -> urllib3.BaseHTTPResponse:
        fields = {"User-Agent": "kleinkram-runner", **self._authorization, **headers}
        if self._is_loopback and self._scheme == "https":
            # Like engines: a registry of this machine may have no certificate.
            try:
                return self._send(f"https://{self._host}/v2/{self._path}/{path}", fields, urllib3.Retry(0, redirect=10))
            except urllib3.exceptions.MaxRetryError as error:
                if not isinstance(error.reason, urllib3.exceptions.SSLError):
                    raise
                self._scheme = "http"
        return self._send(f"{self._scheme}://{self._host}/v2/{self._path}/{path}", fields, _RETRIES)

    def _send(self, url: str, fields: Mapping[str, str], retries: urllib3.Retry) -> urllib3.BaseHTTPResponse:
        pool = _pool_for(url)
        return pool.request("GET", url, headers=fields, timeout=_TIMEOUT, retries=retries, preload_content=False)

    def _answer_to(self, challenge: str) -> dict[str, str]:
        """Return the header for a challenge, with the credentials of the runner's user for this registry, if any."""
        known = credentials_for(self._registry)
        basic = {}
        if known is not None and "username" in known:
            pair = f"{known['username']}:{known['password']}".encode()
            basic = {"Authorization": f"Basic {base64.b64encode(pair).decode()}"}
        if challenge.lower().startswith("basic"):
            return basic
        values = dict(_CHALLENGE.findall(challenge))
        realm = values.pop("realm", "")
        if not realm.startswith("https://") and not self._is_loopback:
            raise RegistryFailure(f"{self._registry} asks for a token from an address that is not HTTPS.")
        query = {"service": values.get("service", ""), "scope": f"repository:{self._path}:pull"}
        pool = _pool_for(realm)
        if known is not None and "identitytoken" in known:
            form = {"grant_type": "refresh_token", "refresh_token": known["identitytoken"], "client_id": "kleinkram"}
            answer = pool.request("POST", realm, fields={**query, **form}, encode_multipart=False, timeout=_TIMEOUT)
        else:
            url = f"{realm}{'&' if urlsplit(realm).query else '?'}{urlencode(query)}"
            answer = pool.request("GET", url, headers=basic, timeout=_TIMEOUT, retries=_RETRIES)
        if answer.status >= 300:
            return basic
        try:
            body = answer.json()
            return {"Authorization": f"Bearer {body.get('token') or body['access_token']}"}
        except (ValueError, KeyError, AttributeError):
            return basic

    def _away(self, error: Exception) -> RegistryFailure:
        reason = getattr(error, "reason", None) or error
        return RegistryFailure(f"The registry {self._registry} does not answer: {reason}.")


def find_digest(name: ImageName) -> str:
    """Return the digest that a name stands for.

    Raises:
        RegistryFailure: the registry does not answer, or has no such image.
    """
    return RegistryClient(name, "").find_digest()


def _pool_for(url: str) -> urllib3.PoolManager:
    """Return connections for a URL, through the proxy of the environment if it names one."""
    parts = urlsplit(url)
    proxy = urllib.request.getproxies().get(parts.scheme)
    context = ssl.create_default_context()
    if proxy and not is_loopback(parts.netloc) and not urllib.request.proxy_bypass(parts.hostname or ""):
        return urllib3.ProxyManager(proxy, ssl_context=context)
    return urllib3.PoolManager(ssl_context=context)


def is_loopback(host: str) -> bool:
    """Whether a host, with a port or without, is this machine."""
    name = host.rpartition(":")[0] if re.search(r":\d+$", host) else host
    if name == "localhost":
        return True
    try:
        return ipaddress.ip_address(name.strip("[]")).is_loopback
    except ValueError:
        return False


def _digest_of(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def _message(data: bytes) -> str:
    try:
        return str(json.loads(data)["errors"][0]["message"])
    except (ValueError, KeyError, IndexError, TypeError):
        return ""


def _parse(model: type[_Document], data: bytes, name: ImageName) -> _Document:
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        reason = first_problem(error)
        raise RegistryFailure(f"The image {name.repository} has a damaged description: {reason}.") from error
