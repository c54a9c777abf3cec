"""Which server a client uses, and the saved servers with their tokens.

The saved endpoints are one file that only its owner may read.
"""

import datetime
import enum
import fcntl
import json
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import urlsplit

import platformdirs
from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.errors import (
    ConfigurationBroken,
    CredentialsExposed,
    EndpointTaken,
    InvalidInput,
    NoSuchEndpoint,
    NotConfigured,
)
from kleinkram.contract.problems import first_problem
from kleinkram.contract.tokens import SHARE_PAGE

APPLICATION = "kleinkram"
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class SavedEndpoint(BaseModel):
    """One server with its token, and, if known, the account and the end of the token."""

    model_config = ConfigDict(frozen=True)

    url: str
    token: str
    person: str | None = None
    expires_at: datetime.datetime | None = None
    # Created by `klein login` for this machine: signing in again revokes it.
    is_own: bool = False

    def __repr_args__(self) -> Iterator[tuple[str | None, object]]:
        """Leave the token out of the representation."""
        yield from ((name, value) for name, value in super().__repr_args__() if name != "token")


class SavedEndpoints(BaseModel):
    """The file of endpoints; `current` is the one chosen with `klein endpoint use`, or signed in to last."""

    model_config = ConfigDict(frozen=True)

    version: int = 1
    current: str | None = None
    endpoints: dict[str, SavedEndpoint] = {}


def endpoints_file() -> Path:
    """Return the path of the file of endpoints."""
    return Path(platformdirs.user_config_dir(APPLICATION)) / "endpoints.json"


def load_endpoints() -> SavedEndpoints:
    """Return the saved endpoints; CredentialsExposed where others can read or change the file."""
    path = endpoints_file()
    try:
        with path.open("rb") as file:
            mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
            if mode & _OTHERS:
                raise CredentialsExposed(file=str(path), mode=f"{mode:04o}")
            return SavedEndpoints.model_validate_json(file.read())
    except FileNotFoundError:
        return SavedEndpoints()
    except (OSError, ValidationError) as error:
        raise ConfigurationBroken(file=str(path), reason=short_reason(error)) from error


def add_endpoint(name: str, endpoint: SavedEndpoint, *, choose: bool = False) -> SavedEndpoints:
    """Save an endpoint under a name; it is used from now on if it is the first, or with `choose`.

    Raises:
        InvalidInput: the URL is not valid, or the name or token is empty.
        EndpointTaken: the name is that of another server.
    """
    if not name or not endpoint.token:
        raise InvalidInput(what="The endpoint", reason="it needs a name and a token")
    added = endpoint.model_copy(update={"url": normal_url(endpoint.url)})
    with _changing() as saved:
        existing = saved.endpoints.get(name)
        if existing is not None and existing.url != added.url:
            raise EndpointTaken(name=name, url=existing.url)
        current = name if choose or saved.current is None else saved.current
        return _save(saved.model_copy(update={"endpoints": {**saved.endpoints, name: added}, "current": current}))


def use_endpoint(name: str) -> SavedEndpoints:
    """Choose the endpoint that commands use from now on."""
    with _changing() as saved:
        require_endpoint(saved, name)
        return _save(saved.model_copy(update={"current": name}))


def remove_endpoint(name: str, *, token: str | None = None) -> SavedEndpoints:
    """Remove an endpoint and its token; with `token`, only if that is still the one saved."""
    with _changing() as saved:
        existing = require_endpoint(saved, name)
        if token is not None and existing.token != token:
            return saved
        left = {key: value for key, value in saved.endpoints.items() if key != name}
        current = None if saved.current == name else saved.current
        return _save(saved.model_copy(update={"endpoints": left, "current": current}))


def require_endpoint(saved: SavedEndpoints, name: str) -> SavedEndpoint:
    """Return the endpoint of a name; raise NoSuchEndpoint if there is none."""
    if name not in saved.endpoints:
        raise NoSuchEndpoint(name=name, known=", ".join(sorted(saved.endpoints)) or "none")
    return saved.endpoints[name]


def name_for(url: str, saved: SavedEndpoints) -> str:
    """Return the name under which a server is saved, else its host and port."""
    for name, endpoint in saved.endpoints.items():
        if endpoint.url == url:
            return name
    return urlsplit(url).netloc


def normal_url(url: str) -> str:
    """Return a server's URL without a slash at its end; raise InvalidInput unless it is an http or https URL."""
    try:
        parts = urlsplit(url)
        usable = parts.scheme in {"http", "https"} and bool(parts.hostname) and (parts.port is None or parts.port > 0)
        usable = usable and not (parts.query or parts.fragment or parts.username)
    except ValueError:
        usable = False
    if not usable:
        raise InvalidInput(what=f"The URL {url!r}", reason="it must look like http://host:port or https://host")
    return url.rstrip("/")


def short_reason(error: Exception) -> str:
    """Return why a file cannot be used, without its content, which may be secret."""
    if isinstance(error, ValidationError):
        return first_problem(error)
    return getattr(error, "strerror", None) or str(error)


@contextmanager
def _changing() -> Iterator[SavedEndpoints]:
    """Yield the saved endpoints, locked against other processes."""
    path = endpoints_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise ConfigurationBroken(file=str(path), reason=short_reason(error)) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield load_endpoints()
    finally:
        os.close(lock)


def _save(saved: SavedEndpoints) -> SavedEndpoints:
    path = endpoints_file()
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".endpoints-")  # made with mode 0600
        try:
            with os.fdopen(handle, "w") as out:
                json.dump(saved.model_dump(mode="json"), out, indent=2)
                out.flush()
                os.fsync(out.fileno())
            Path(temporary).replace(path)
        except OSError:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise ConfigurationBroken(file=str(path), reason=short_reason(error)) from error
    return saved


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
    # None: anonymous, for what is public and for signing in.
    token: str | None = field(repr=False)
    source: EndpointSource
    # The token comes from the caller, or from the address of a link: it cannot be found again.
    has_explicit_token: bool = False

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without the token where this user's configuration has it; else with it."""
        token = self.token if self.has_explicit_token else None
        return _find_again, (self.name, self.url, token, self.source, self.token is not None)


class _Instance(BaseModel):
    url: str
    token_file: Path


def data_dir() -> Path:
    """Return the folder of this user's instance of `klein up`."""
    override = os.environ.get(DATA_DIR_VARIABLE)
    return Path(override) if override else Path(platformdirs.user_data_dir(APPLICATION))


def state_dir() -> Path:
    """Return the state directory, which holds the journals of transfers."""
    return Path(platformdirs.user_state_dir(APPLICATION))


def find_endpoint(url: str | None = None, token: str | None = None) -> Endpoint:
    """Return the endpoint to use: the one given, of the environment, chosen, or this user's own instance.

    Raises:
        NotConfigured: there is none.
        ConfigurationBroken: a file that should name it cannot be read.
        CredentialsExposed: others can read the file of tokens.
    """
    if url:
        endpoint = _with_token("(given)", url, token, EndpointSource.argument)
    elif override := os.environ.get(URL_VARIABLE):
        known = token or os.environ.get(TOKEN_VARIABLE)
        endpoint = _with_token("(environment)", override, known, EndpointSource.environment)
    else:
        saved = load_endpoints()
        if saved.current and (chosen := saved.endpoints.get(saved.current)):
            endpoint = Endpoint(saved.current, chosen.url, token or chosen.token, EndpointSource.chosen)
        elif (local := find_local()) is not None:
            endpoint = local if token is None else replace(local, token=token)
        else:
            raise NotConfigured(
                reason=f"no endpoint was chosen, and there is no instance of `klein up` in {data_dir()} "
                f"(where it was started with --data-dir D, set {DATA_DIR_VARIABLE}=D)"
            )
    is_explicit = endpoint.token is not None and (endpoint.token == token or f"{SHARE_PAGE}#" in (url or ""))
    return replace(endpoint, has_explicit_token=is_explicit)


def _find_again(name: str, url: str, token: str | None, source: EndpointSource, had_token: bool) -> Endpoint:
    """Return a pickled endpoint, with the token that is configured for it here."""
    if token is not None:
        return replace(find_endpoint(url, token), name=name, source=source)
    endpoint: Endpoint | None = None
    if source is EndpointSource.environment and os.environ.get(URL_VARIABLE):
        endpoint = find_endpoint()
    elif (saved := load_endpoints().endpoints.get(name)) is not None:
        endpoint = Endpoint(name, saved.url, saved.token, source)
    if endpoint is None or endpoint.url != url:
        endpoint = replace(find_endpoint(url), name=name, source=source)
    if had_token and endpoint.token is None:
        raise NotConfigured(reason=f"this was pickled where a token for {url} was configured, and here there is none")
    return endpoint


def find_local() -> Endpoint | None:
    """Return the instance of `klein up` in the data directory, or None."""
    path = data_dir() / "instance.json"
    try:
        instance = _Instance.model_validate_json(path.read_bytes())
        token = (path.parent / instance.token_file).read_text().strip()
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise ConfigurationBroken(file=str(path), reason=short_reason(error)) from error
    return Endpoint("local", normal_url(instance.url), token, EndpointSource.local)


def _with_token(name: str, override: str, token: str | None, source: EndpointSource) -> Endpoint:
    base, _, secret = override.partition(f"{SHARE_PAGE}#")  # a link's address is also its secret
    # A token for another server is not sent to the link's.
    url, token = normal_url(base), secret or token
    if not token:
        local = find_local()
        if local is not None and local.url == url:
            token = local.token
        else:
            token = next((saved.token for saved in load_endpoints().endpoints.values() if saved.url == url), None)
    return Endpoint(name, url, token, source)
