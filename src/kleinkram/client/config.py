"""Which server a client talks to, and why that one.

In this order: what the caller gives; KLEINKRAM_URL and KLEINKRAM_TOKEN; the endpoint chosen with `klein endpoint use`;
the instance that `klein up` runs for this user. The file of endpoints holds tokens, so it is written with mode 0600.
"""

import enum
import json
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import platformdirs
from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.errors import ConfigurationBroken, InvalidInput, NoSuchEndpoint, NotConfigured

APPLICATION = "kleinkram"
URL_VARIABLE = "KLEINKRAM_URL"
TOKEN_VARIABLE = "KLEINKRAM_TOKEN"  # noqa: S105  the variable's name
DATA_DIR_VARIABLE = "KLEINKRAM_DATA_DIR"


class EndpointSource(str, enum.Enum):
    """Why an endpoint is the one in use."""

    argument = "argument"
    environment = "environment"
    chosen = "chosen"
    local = "local"


@dataclass(frozen=True)
class Endpoint:
    """A server, the token for it, and where both came from."""

    name: str
    url: str
    token: str
    source: EndpointSource


class SavedEndpoint(BaseModel):
    """One server in the file of endpoints."""

    model_config = ConfigDict(frozen=True)

    url: str
    token: str


class SavedEndpoints(BaseModel):
    """The file of endpoints; `current` is the one chosen with `klein endpoint use`."""

    model_config = ConfigDict(frozen=True)

    version: int = 1
    current: str | None = None
    endpoints: dict[str, SavedEndpoint] = {}


class _Instance(BaseModel):
    url: str
    token_file: Path


def endpoints_file() -> Path:
    """Return where the endpoints are kept."""
    return Path(platformdirs.user_config_dir(APPLICATION)) / "endpoints.json"


def data_dir() -> Path:
    """Return where `klein up` keeps this user's instance."""
    given = os.environ.get(DATA_DIR_VARIABLE)
    return Path(given) if given else Path(platformdirs.user_data_dir(APPLICATION))


def state_dir() -> Path:
    """Return where journals of transfers are kept."""
    return Path(platformdirs.user_state_dir(APPLICATION))


def load_endpoints() -> SavedEndpoints:
    """Return the saved endpoints; none when there is no file yet.

    Raises:
        ConfigurationBroken: the file cannot be read.
    """
    path = endpoints_file()
    try:
        return SavedEndpoints.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return SavedEndpoints()
    except (OSError, ValidationError) as error:
        raise ConfigurationBroken(file=str(path), reason=_short(error)) from error


def add_endpoint(name: str, url: str, token: str) -> SavedEndpoints:
    """Save an endpoint under a name, replacing one of that name, and choose it when it is the first.

    Raises:
        InvalidInput: the URL is none, or the name or token is empty.
    """
    if not name or not token:
        raise InvalidInput(what="The endpoint", reason="it needs a name and a token")
    saved = load_endpoints()
    endpoints = {**saved.endpoints, name: SavedEndpoint(url=normal_url(url), token=token)}
    return _save(saved.model_copy(update={"endpoints": endpoints, "current": saved.current or name}))


def use_endpoint(name: str) -> SavedEndpoints:
    """Choose the endpoint that commands use from now on.

    Raises:
        NoSuchEndpoint: none has that name.
    """
    saved = load_endpoints()
    _require(saved, name)
    return _save(saved.model_copy(update={"current": name}))


def remove_endpoint(name: str) -> SavedEndpoints:
    """Forget an endpoint and its token.

    Raises:
        NoSuchEndpoint: none has that name.
    """
    saved = load_endpoints()
    _require(saved, name)
    left = {key: value for key, value in saved.endpoints.items() if key != name}
    current = None if saved.current == name else saved.current
    return _save(saved.model_copy(update={"endpoints": left, "current": current}))


def find_endpoint(url: str | None = None, token: str | None = None) -> Endpoint:
    """Return the endpoint to use.

    Raises:
        NotConfigured: there is none, or no token for it.
        ConfigurationBroken: a file that should name it cannot be read.
    """
    if url:
        return _with_token("(given)", normal_url(url), token, EndpointSource.argument)
    if given := os.environ.get(URL_VARIABLE):
        known = token or os.environ.get(TOKEN_VARIABLE)
        return _with_token("(environment)", normal_url(given), known, EndpointSource.environment)
    saved = load_endpoints()
    if saved.current and (chosen := saved.endpoints.get(saved.current)):
        return Endpoint(saved.current, chosen.url, token or chosen.token, EndpointSource.chosen)
    local = find_local()
    if local is None:
        raise NotConfigured(reason="no endpoint was chosen and this user has no instance of `klein up`")
    return local if token is None else Endpoint(local.name, local.url, token, local.source)


def find_local() -> Endpoint | None:
    """Return the instance that `klein up` has announced in the data directory, or None.

    Raises:
        ConfigurationBroken: it is announced, but its files cannot be read.
    """
    path = data_dir() / "instance.json"
    try:
        instance = _Instance.model_validate_json(path.read_bytes())
        token = (path.parent / instance.token_file).read_text().strip()
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise ConfigurationBroken(file=str(path), reason=_short(error)) from error
    return Endpoint("local", normal_url(instance.url), token, EndpointSource.local)


def normal_url(url: str) -> str:
    """Return a server's URL without a slash at its end.

    Raises:
        InvalidInput: it is not an http or https URL.
    """
    try:
        parts = urlsplit(url)
        usable = parts.scheme in {"http", "https"} and bool(parts.hostname) and (parts.port is None or parts.port > 0)
    except ValueError:
        usable = False
    if not usable:
        raise InvalidInput(what=f"The URL {url!r}", reason="it must look like http://host:port or https://host")
    return url.rstrip("/")


def _with_token(name: str, url: str, token: str | None, source: EndpointSource) -> Endpoint:
    if token:
        return Endpoint(name, url, token, source)
    local = find_local()
    if local is not None and local.url == url:
        return Endpoint(name, url, local.token, source)
    for saved in load_endpoints().endpoints.values():
        if saved.url == url:
            return Endpoint(name, url, saved.token, source)
    raise NotConfigured(reason=f"there is no token for {url}")


def _require(saved: SavedEndpoints, name: str) -> None:
    if name not in saved.endpoints:
        raise NoSuchEndpoint(name=name, known=", ".join(sorted(saved.endpoints)) or "none")


def _save(saved: SavedEndpoints) -> SavedEndpoints:
    path = endpoints_file()
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    handle, temporary = tempfile.mkstemp(dir=path.parent)  # made with mode 0600
    with os.fdopen(handle, "w") as out:
        json.dump(saved.model_dump(), out, indent=2)
    Path(temporary).replace(path)
    return saved


def _short(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        return f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}"
    return getattr(error, "strerror", None) or str(error)
