"""Which server a client talks to, and why that one.

In this order: what the caller gives; KLEINKRAM_URL and KLEINKRAM_TOKEN; the endpoint signed in to last, or chosen with
`klein endpoint use`; the instance that `klein up` runs for this user.
"""

import enum
import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import platformdirs
from pydantic import BaseModel, ValidationError

from kleinkram.client.errors import ConfigurationBroken, NotConfigured
from kleinkram.client.saved_endpoints import APPLICATION, load_endpoints, normal_url, short_reason
from kleinkram.contract.shares import SHARE_PAGE

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
    # None: as nobody in particular, who may read what is public, and ask for a token.
    token: str | None = field(repr=False)
    source: EndpointSource
    # Said by the caller, or in the address of a link: known nowhere else.
    is_token_given: bool = False

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without the token where it can be read again from this user's configuration; else with it."""
        token = self.token if self.is_token_given else None
        return _find_again, (self.name, self.url, token, self.source, self.token is not None)


class _Instance(BaseModel):
    url: str
    token_file: Path


def data_dir() -> Path:
    """Return where `klein up` keeps this user's instance."""
    given = os.environ.get(DATA_DIR_VARIABLE)
    return Path(given) if given else Path(platformdirs.user_data_dir(APPLICATION))


def state_dir() -> Path:
    """Return where journals of transfers are kept."""
    return Path(platformdirs.user_state_dir(APPLICATION))


def find_endpoint(url: str | None = None, token: str | None = None) -> Endpoint:
    """Return the endpoint to use.

    Raises:
        NotConfigured: there is none.
        ConfigurationBroken: a file that should name it cannot be read.
        CredentialsExposed: others can read the file of tokens.
    """
    endpoint = _find_endpoint(url, token)
    is_given = endpoint.token is not None and (endpoint.token == token or f"{SHARE_PAGE}#" in (url or ""))
    return replace(endpoint, is_token_given=is_given)


def _find_again(name: str, url: str, token: str | None, source: EndpointSource, had_token: bool) -> Endpoint:
    """Return a pickled endpoint, with the token that is configured for it here.

    Raises:
        NotConfigured: it had a token, and none is configured here.
    """
    if token is not None:
        return replace(find_endpoint(url, token), name=name, source=source)
    found: Endpoint | None = None
    if source is EndpointSource.environment and os.environ.get(URL_VARIABLE):
        found = find_endpoint()
    elif (saved := load_endpoints().endpoints.get(name)) is not None:
        found = Endpoint(name, saved.url, saved.token, source)
    if found is None or found.url != url:
        found = replace(find_endpoint(url), name=name, source=source)
    if had_token and found.token is None:
        raise NotConfigured(reason=f"this was pickled where a token for {url} was configured, and here there is none")
    return found


def _find_endpoint(url: str | None, token: str | None) -> Endpoint:
    if url:
        return _with_token("(given)", url, token, EndpointSource.argument)
    if given := os.environ.get(URL_VARIABLE):
        known = token or os.environ.get(TOKEN_VARIABLE)
        return _with_token("(environment)", given, known, EndpointSource.environment)
    saved = load_endpoints()
    if saved.current and (chosen := saved.endpoints.get(saved.current)):
        return Endpoint(saved.current, chosen.url, token or chosen.token, EndpointSource.chosen)
    local = find_local()
    if local is None:
        raise NotConfigured(
            reason=f"no endpoint was chosen, and there is no instance of `klein up` in {data_dir()} "
            f"(where it was started with --data-dir D, set {DATA_DIR_VARIABLE}=D)"
        )
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
        raise ConfigurationBroken(file=str(path), reason=short_reason(error)) from error
    return Endpoint("local", normal_url(instance.url), token, EndpointSource.local)


def _with_token(name: str, given: str, token: str | None, source: EndpointSource) -> Endpoint:
    base, _, secret = given.partition(f"{SHARE_PAGE}#")  # a link's address is also its secret
    # What is known for another server is not shown to the link's.
    url, token = normal_url(base), secret or token
    if token:
        return Endpoint(name, url, token, source)
    local = find_local()
    if local is not None and local.url == url:
        return Endpoint(name, url, local.token, source)
    for saved in load_endpoints().endpoints.values():
        if saved.url == url:
            return Endpoint(name, url, saved.token, source)
    return Endpoint(name, url, None, source)
