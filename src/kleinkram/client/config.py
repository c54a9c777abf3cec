"""Which server a client talks to, and why that one.

In this order: what the caller gives; KLEINKRAM_URL and KLEINKRAM_TOKEN; the endpoint signed in to last, or chosen with
`klein endpoint use`; the instance that `klein up` runs for this user.
"""

import enum
import os
from dataclasses import dataclass, field
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
