"""`klein login`, `klein logout`, `klein whoami`: the token of this machine, which only its user can read."""

import os
import socket
import sys
import webbrowser
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Annotated
from urllib.parse import urlsplit

import typer

from kleinkram import connect
from kleinkram.cli.errors import exit_code_of
from kleinkram.cli.options import AsJson, read_token
from kleinkram.cli.render import details, escape, moment, note, show_json
from kleinkram.client.config import (
    TOKEN_VARIABLE,
    URL_VARIABLE,
    EndpointSource,
    SavedEndpoint,
    add_endpoint,
    find_endpoint,
    load_endpoints,
    name_for,
    normal_url,
    remove_endpoint,
    require_endpoint,
)
from kleinkram.client.errors import EndpointTaken, InvalidInput, NoBrowser
from kleinkram.client.sign_in import begin_browser, begin_device, end_token, see_server, wait_for_device, who_has
from kleinkram.contract.accounts import SignedIn
from kleinkram.contract.errors import KleinkramError

_LOOPBACK = {"127.0.0.1", "::1", "localhost"}


def login(
    url: Annotated[
        str | None, typer.Argument(metavar="URL", show_default=False, help="The server; else the one in use.")
    ] = None,
    device: Annotated[
        bool, typer.Option("--device", help="Show a code to type in a browser elsewhere, as over ssh.")
    ] = False,
    token: Annotated[
        bool, typer.Option("--token", help="Take a token from stdin, a prompt that does not echo, or KLEINKRAM_TOKEN.")
    ] = False,
    name: Annotated[
        str | None, typer.Option("--name", metavar="NAME", help="What to call the endpoint. Default: the host.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Sign in to a server by the browser, by a code typed elsewhere, or by a token. Commands talk to it from now."""
    if device and token:
        raise InvalidInput(what="The command", reason="say --device or --token, not both")
    server = _server(url)
    _warn_of_plain_http(server)
    saved_as, before = _place(server, name)
    if token:
        endpoint = _brought_along(server)
    else:
        endpoint = _own(server, _by_code(server) if device else _by_browser(server))
    _keep(saved_as, endpoint)
    if before is not None and before.is_own and before.token != endpoint.token:
        with suppress(KleinkramError):  # it ends by itself, only later
            end_token(before.url, before.token)
    _report_login(saved_as, endpoint, as_json)


def _server(url: str | None) -> str:
    if explicit_url := url or os.environ.get(URL_VARIABLE):
        return normal_url(explicit_url)
    used = find_endpoint()
    if used.source is EndpointSource.local:
        reason = "the server in use runs on this machine and knows you by a file; give a URL to sign in elsewhere"
        raise InvalidInput(what="klein login", reason=f"{reason}, or `klein session link` to a browser")
    return used.url


def _warn_of_plain_http(server: str) -> None:
    parts = urlsplit(server)
    if parts.scheme == "http" and parts.hostname not in _LOOPBACK:
        note(f"{server} is not encrypted: whoever is on the way sees the token. Use it on a network that you trust.")


def _place(server: str, name: str | None) -> tuple[str, SavedEndpoint | None]:
    saved = load_endpoints()
    saved_as = name or name_for(server, saved)
    before = saved.endpoints.get(saved_as)
    if before is not None and before.url != server:  # said before somebody signs in for nothing
        raise EndpointTaken(name=saved_as, url=before.url)
    return saved_as, before


def _brought_along(server: str) -> SavedEndpoint:
    secret = _token()
    if not secret:
        raise InvalidInput(what="The token", reason=f"none came from stdin, and {TOKEN_VARIABLE} is not set")
    me = who_has(server, secret)
    return SavedEndpoint(url=server, token=secret, person=me.person.name, expires_at=me.credential.expires_at)


def _token() -> str:
    from_environment = os.environ.get(TOKEN_VARIABLE, "").strip()
    if sys.stdin.isatty() and from_environment:
        return from_environment
    return read_token() or from_environment


def _own(server: str, got: SignedIn) -> SavedEndpoint:
    return SavedEndpoint(url=server, token=got.token, person=got.person.name, expires_at=got.expires_at, is_own=True)


def _by_code(server: str) -> SignedIn:
    code = begin_device(server, _client_name())
    note(f"Open {escape(code.verification_url)} in any browser, and type {escape(code.user_code)}")
    note(f"or open {escape(code.verification_url_complete)}")
    note(f"Waiting for it, {code.expires_s / 60:.0f} minutes at most …")
    return wait_for_device(server, code)


def _by_browser(server: str) -> SignedIn:
    if not _has_browser():
        raise NoBrowser(url=server)
    see_server(server)
    with begin_browser(server, _client_name()) as waiting:
        note(f"Opening {waiting.url}")
        if not webbrowser.open(waiting.url):
            raise NoBrowser(url=server)
        note("Waiting for you to sign in there. Where no window opens: Ctrl-C, and `klein login --device`.")
        return waiting.wait()


def _has_browser() -> bool:
    """Say whether a window could open: text browsers would take the terminal, and know no way back to it."""
    if os.environ.get("BROWSER") or not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _client_name() -> str:
    name = f"klein on {socket.gethostname()}"
    return "".join(letter for letter in name if letter.isprintable())[:100]


def _keep(name: str, endpoint: SavedEndpoint) -> None:
    try:
        add_endpoint(name, endpoint, choose=True)
    except KleinkramError:
        if endpoint.is_own:  # else nobody would know of it
            with suppress(KleinkramError):
                end_token(endpoint.url, endpoint.token)
        raise


def _report_login(name: str, endpoint: SavedEndpoint, as_json: bool) -> None:
    until = endpoint.expires_at
    if as_json:
        expires_at = until.isoformat() if until else None
        show_json({"name": name, "url": endpoint.url, "person": endpoint.person, "expires_at": expires_at})
    ending = f" until {moment(until)}" if until else ""
    note(f"Signed in to {endpoint.url} as {escape(endpoint.person or '')}{ending}. The endpoint {name} is in use now.")
    if (used := find_endpoint()).source is EndpointSource.environment and used.token != endpoint.token:
        note(f"But {URL_VARIABLE} and {TOKEN_VARIABLE} are set, and go before it.")


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
    _report_logout(name, endpoint, revoked, reason)
    return _Ended(name, endpoint.url, revoked, reason)


def _report_logout(name: str, endpoint: SavedEndpoint, revoked: bool, reason: str | None) -> None:
    if reason is None:
        ending = "its token is revoked" if revoked else "its token was good for nothing already"
        note(f"Signed out of {endpoint.url}: {ending}, and {name} is forgotten.")
        return
    until = f"until {moment(endpoint.expires_at)}" if endpoint.expires_at else "for good"
    note(f"Error: the token for {endpoint.url} could not be revoked: {escape(reason)}")
    note(f"{name} is forgotten here, but its token is valid there {until}. Sign in again and `klein token revoke` it.")


def whoami(as_json: AsJson = False) -> None:
    """Say who the server in use takes you for, and what your token is good for."""
    with connect() as client:
        me, endpoint = client.me.get(), client.endpoint
    if as_json:
        show_json({**me.model_dump(mode="json"), "endpoint": endpoint.name, "url": endpoint.url})
        return
    credential = me.credential
    details(
        [
            ("person", me.person.name),
            ("e-mail", me.emails),
            ("admin", "yes" if me.is_admin else None),
            ("by", f"{credential.kind.value} token {credential.name!r}"),
            ("good for", [scope.value for scope in credential.scopes]),
            ("limited", "to certain projects or missions" if credential.is_limited else None),
            ("until", credential.expires_at),
            ("server", endpoint.url),
            ("endpoint", endpoint.name),
        ]
    )
