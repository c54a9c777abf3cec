"""The servers that this user has signed in to, with the tokens for them: one file, for its owner's eyes alone.

It is replaced as a whole, never changed in place, and by one process at a time: two `klein login` at once lose nothing.
A file that others can read is refused, as ssh refuses such a key: whoever may have read it has the tokens.
"""

import datetime
import fcntl
import json
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import platformdirs
from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.errors import ConfigurationBroken, CredentialsExposed, EndpointTaken, InvalidInput, NoSuchEndpoint
from kleinkram.contract.wording import first_problem

APPLICATION = "kleinkram"
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class SavedEndpoint(BaseModel):
    """One server: the token for it, and, where that was asked, whose it is and until when it is good."""

    model_config = ConfigDict(frozen=True)

    url: str
    token: str
    person: str | None = None
    expires_at: datetime.datetime | None = None
    # Made by `klein login` for this machine, rather than brought along: signing in again does away with it.
    is_own: bool = False

    def __repr_args__(self) -> Iterator[tuple[str | None, object]]:
        """Leave the token out of what is printed of it."""
        yield from ((name, value) for name, value in super().__repr_args__() if name != "token")


class SavedEndpoints(BaseModel):
    """The file of endpoints; `current` is the one chosen with `klein endpoint use`, or signed in to last."""

    model_config = ConfigDict(frozen=True)

    version: int = 1
    current: str | None = None
    endpoints: dict[str, SavedEndpoint] = {}


def endpoints_file() -> Path:
    """Return where the endpoints are kept."""
    return Path(platformdirs.user_config_dir(APPLICATION)) / "endpoints.json"


def load_endpoints() -> SavedEndpoints:
    """Return the saved endpoints; none when there is no file yet.

    Raises:
        ConfigurationBroken: the file cannot be read.
        CredentialsExposed: others can read or change it.
    """
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
    """Save an endpoint under a name, instead of what is saved for that server there; chosen if the first, or asked for.

    Raises:
        InvalidInput: the URL is none, or the name or token is empty.
        EndpointTaken: the name is that of another server.
    """
    if not name or not endpoint.token:
        raise InvalidInput(what="The endpoint", reason="it needs a name and a token")
    added = endpoint.model_copy(update={"url": normal_url(endpoint.url)})
    with _changing() as saved:
        held = saved.endpoints.get(name)
        if held is not None and held.url != added.url:
            raise EndpointTaken(name=name, url=held.url)
        current = name if choose or saved.current is None else saved.current
        return _save(saved.model_copy(update={"endpoints": {**saved.endpoints, name: added}, "current": current}))


def use_endpoint(name: str) -> SavedEndpoints:
    """Choose the endpoint that commands use from now on.

    Raises:
        NoSuchEndpoint: none has that name.
    """
    with _changing() as saved:
        require_endpoint(saved, name)
        return _save(saved.model_copy(update={"current": name}))


def remove_endpoint(name: str, *, token: str | None = None) -> SavedEndpoints:
    """Forget an endpoint and its token; with `token`, only if it still is the one saved.

    Raises:
        NoSuchEndpoint: none has that name.
    """
    with _changing() as saved:
        held = require_endpoint(saved, name)
        if token is not None and held.token != token:
            return saved
        left = {key: value for key, value in saved.endpoints.items() if key != name}
        current = None if saved.current == name else saved.current
        return _save(saved.model_copy(update={"endpoints": left, "current": current}))


def require_endpoint(saved: SavedEndpoints, name: str) -> SavedEndpoint:
    """Return the endpoint of a name.

    Raises:
        NoSuchEndpoint: none has it.
    """
    if name not in saved.endpoints:
        raise NoSuchEndpoint(name=name, known=", ".join(sorted(saved.endpoints)) or "none")
    return saved.endpoints[name]


def name_for(url: str, saved: SavedEndpoints) -> str:
    """Return the name under which a server is saved, else its host, with its port where that is not the usual one."""
    for name, endpoint in saved.endpoints.items():
        if endpoint.url == url:
            return name
    return urlsplit(url).netloc


def normal_url(url: str) -> str:
    """Return a server's URL without a slash at its end.

    Raises:
        InvalidInput: it is not an http or https URL.
    """
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
    """Return why a file cannot be used, without what stands in it: that may be a secret."""
    if isinstance(error, ValidationError):
        return first_problem(error)
    return getattr(error, "strerror", None) or str(error)


@contextmanager
def _changing() -> Iterator[SavedEndpoints]:
    """Give what is saved, while no other process changes it."""
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
