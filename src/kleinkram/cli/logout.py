"""`klein logout`: the token ends at the server, then on this machine."""

from dataclasses import asdict, dataclass
from typing import Annotated

import typer

from kleinkram.cli.errors import exit_code_of
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import escape, moment, note, show_json
from kleinkram.client.config import (
    TOKEN_VARIABLE,
    EndpointSource,
    SavedEndpoint,
    find_endpoint,
    load_endpoints,
    remove_endpoint,
    require_endpoint,
)
from kleinkram.client.errors import InvalidInput
from kleinkram.client.sign_in import end_token
from kleinkram.contract.errors import KleinkramError


@dataclass(frozen=True)
class _Ended:
    name: str
    url: str
    revoked: bool
    reason: str | None


def logout(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", show_default=False, help="The endpoint; else the one in use.")
    ] = None,
    everywhere: Annotated[bool, typer.Option("--all", help="Sign out of every server that is saved here.")] = False,
    as_json: AsJson = False,
) -> None:
    """Sign out: revoke the token at its server and forget it here. It is forgotten even where it cannot be revoked."""
    if name is not None and everywhere:
        raise InvalidInput(what="The command", reason="say which endpoint, or --all, not both")
    saved = load_endpoints()
    if everywhere:
        chosen = dict(saved.endpoints)
    else:
        chosen = {name: require_endpoint(saved, name)} if name else _in_use()
    failures: list[KleinkramError] = []
    ended = [_end(one, endpoint, failures) for one, endpoint in chosen.items()]
    if as_json:
        show_json({"items": [asdict(one) for one in ended]})
    elif not ended:
        note("No server is saved here, so there is nothing to sign out of.")
    if failures:
        raise typer.Exit(exit_code_of(failures))


def _in_use() -> dict[str, SavedEndpoint]:
    """Return what is saved of the endpoint in use.

    Raises:
        InvalidInput: it is not one that was signed in to.
    """
    used = find_endpoint()
    if used.source is EndpointSource.chosen:
        return {used.name: load_endpoints().endpoints[used.name]}
    if used.source is EndpointSource.local:
        reason = "the server in use runs on this machine, and knows its owner by a file; `klein down` ends it"
    else:
        reason = f"the token in use comes from {TOKEN_VARIABLE}; unset that, or name an endpoint"
    raise InvalidInput(what="klein logout", reason=reason)


def _end(name: str, endpoint: SavedEndpoint, failures: list[KleinkramError]) -> _Ended:
    reason = None
    try:
        revoked = end_token(endpoint.url, endpoint.token)
    except KleinkramError as error:
        failures.append(error)
        revoked, reason = False, str(error)
    remove_endpoint(name, token=endpoint.token)
    _tell(name, endpoint, revoked, reason)
    return _Ended(name, endpoint.url, revoked, reason)


def _tell(name: str, endpoint: SavedEndpoint, revoked: bool, reason: str | None) -> None:
    if reason is None:
        ending = "its token is revoked" if revoked else "its token was good for nothing already"
        note(f"Signed out of {endpoint.url}: {ending}, and {name} is forgotten.")
        return
    until = f"until {moment(endpoint.expires_at)}" if endpoint.expires_at else "for good"
    note(f"Error: the token for {endpoint.url} could not be revoked: {escape(reason)}")
    note(f"{name} is forgotten here, but its token is valid there {until}. Sign in again and `klein token revoke` it.")
