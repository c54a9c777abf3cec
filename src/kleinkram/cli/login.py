"""`klein login`, `klein logout`, `klein whoami` and `klein endpoint …`: the servers that this machine uses."""

import datetime
import os
import socket
import sys
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import typer

from kleinkram.cli import options
from kleinkram.cli.commands import AsJson, Subcommands, Text, argument, flag, option
from kleinkram.cli.errors import exit_code_of
from kleinkram.cli.render import Output, as_details, details, moment, note, show_json, table
from kleinkram.client import Client, config
from kleinkram.client.config import EndpointSource, SavedEndpoint, endpoints_file, find_endpoint, load_endpoints
from kleinkram.client.errors import EndpointTaken, InvalidInput, NoBrowser, NotConfigured
from kleinkram.client.sign_in import begin_browser, begin_device, check_server, end_token, wait_for_device, who_has
from kleinkram.contract.accounts import SignedIn
from kleinkram.contract.errors import KleinkramError

_LOOPBACK = {"127.0.0.1", "::1", "localhost"}


def login(
    url: Annotated[Text, argument("URL", "The server. Default: the one in use.")] = None,
    device: Annotated[bool, flag("--device", "Show a code to type in a browser elsewhere, as over ssh.")] = False,
    token: Annotated[
        bool, flag("--token", "Read a token from stdin, from a prompt without echo, or from KLEINKRAM_TOKEN.")
    ] = False,
    name: Annotated[Text, option("--name", "NAME", "Name the endpoint. Default: the host.")] = None,
) -> Output:
    """Sign in to a server with the browser, a code typed elsewhere, or a token, and use it from now on."""
    if device and token:
        raise InvalidInput(what="The command", reason="specify --device or --token, not both")
    server = _server(url)
    parts = urlsplit(server)
    if parts.scheme == "http" and parts.hostname not in _LOOPBACK:
        note(f"{server} is not encrypted: others on the network can read the token. Use it on a trusted network.")
    saved = load_endpoints()
    saved_as = name or config.name_for(server, saved)
    before = saved.endpoints.get(saved_as)
    if before is not None and before.url != server:  # checked before somebody signs in for nothing
        raise EndpointTaken(name=saved_as, url=before.url)
    endpoint = _from_token(server) if token else _sign_in(server, device)
    try:
        config.add_endpoint(saved_as, endpoint, choose=True)
    except KleinkramError:
        if endpoint.is_own:  # nothing else uses this token
            with suppress(KleinkramError):
                end_token(endpoint.url, endpoint.token)
        raise
    if before is not None and before.is_own and before.token != endpoint.token:
        with suppress(KleinkramError):  # it expires
            end_token(before.url, before.token)
    end = f" until {moment(endpoint.expires_at)}" if endpoint.expires_at else ""
    note(f"Signed in to {server} as {endpoint.person or ''}{end}. The endpoint {saved_as} is in use now.")
    if (used := find_endpoint()).source is EndpointSource.environment and used.token != endpoint.token:
        note(f"But {config.URL_VARIABLE} and {config.TOKEN_VARIABLE} are set, and take precedence.")
    expires_at = endpoint.expires_at.isoformat() if endpoint.expires_at else None
    return Output({"name": saved_as, "url": server, "person": endpoint.person, "expires_at": expires_at})


def _server(url: str | None) -> str:
    if explicit_url := url or os.environ.get(config.URL_VARIABLE):
        return config.normal_url(explicit_url)
    used = find_endpoint()
    if used.source is EndpointSource.local:
        reason = "the server in use runs on this machine and signs you in with a file; give a URL to sign in elsewhere"
        raise InvalidInput(what="klein login", reason=f"{reason}, or `klein session link` to a browser")
    return used.url


def _from_token(server: str) -> SavedEndpoint:
    from_environment = os.environ.get(config.TOKEN_VARIABLE, "").strip()
    secret = from_environment if sys.stdin.isatty() else ""
    secret = secret or options.read_token() or from_environment
    if not secret:
        raise InvalidInput(what="The token", reason=f"none came from stdin, and {config.TOKEN_VARIABLE} is not set")
    me = who_has(server, secret)
    return SavedEndpoint(url=server, token=secret, person=me.person.name, expires_at=me.credential.expires_at)


def _sign_in(server: str, device: bool) -> SavedEndpoint:
    client_name = "".join(letter for letter in f"klein on {socket.gethostname()}" if letter.isprintable())[:100]
    if device:
        code = begin_device(server, client_name)
        note(f"Open {code.verification_url} in any browser, and type {code.user_code}")
        note(f"or open {code.verification_url_complete}")
        note(f"Waiting for it, {code.expires_s / 60:.0f} minutes at most …")
        signed_in = wait_for_device(server, code)
    else:
        signed_in = _by_browser(server, client_name)
    person, expires_at = signed_in.person.name, signed_in.expires_at
    return SavedEndpoint(url=server, token=signed_in.token, person=person, expires_at=expires_at, is_own=True)


def _by_browser(server: str, client_name: str) -> SignedIn:
    # Text browsers would take over the terminal, and cannot follow the redirect back.
    has_display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if sys.platform.startswith("linux") and not (has_display or os.environ.get("BROWSER")):
        raise NoBrowser(url=server)
    check_server(server)
    with begin_browser(server, client_name) as waiting:
        note(f"Opening {waiting.url}")
        if not webbrowser.open(waiting.url):
            raise NoBrowser(url=server)
        note("Waiting for you to sign in there. Where no window opens: Ctrl-C, and `klein login --device`.")
        return waiting.wait()


def logout(
    name: Annotated[Text, argument("NAME", "The endpoint. Default: the one in use.")] = None,
    everywhere: Annotated[bool, flag("--all", "Sign out of every saved server.")] = False,
) -> Output:
    """Sign out: revoke the token at its server and remove it here, even where it cannot be revoked."""
    if name is not None and everywhere:
        raise InvalidInput(what="The command", reason="specify an endpoint or --all, not both")
    saved = load_endpoints()
    if everywhere:
        chosen = dict(saved.endpoints)
    else:
        chosen = {name: config.require_endpoint(saved, name)} if name else _in_use()
    failures: list[KleinkramError] = []
    items: list[dict[str, object]] = []
    for saved_as, endpoint in chosen.items():
        revoked, reason = False, None
        try:
            revoked = end_token(endpoint.url, endpoint.token)
        except KleinkramError as error:
            failures.append(error)
            reason = str(error)
        config.remove_endpoint(saved_as, token=endpoint.token)
        items.append({"name": saved_as, "url": endpoint.url, "revoked": revoked, "reason": reason})
        if reason is None:
            end = "its token is revoked" if revoked else "its token was no longer valid"
            note(f"Signed out of {endpoint.url}: {end}, and {saved_as} is removed.")
            continue
        until = f"until {moment(endpoint.expires_at)}" if endpoint.expires_at else "for good"
        note(f"Error: the token for {endpoint.url} could not be revoked: {reason}")
        note(
            f"{saved_as} is removed here, but its token is valid there {until}. "
            "Sign in again and `klein token revoke` it."
        )
    text = () if items else "No server is saved here, so there is nothing to sign out of."
    return Output({"items": items}, text, exit_code_of(failures))


def _in_use() -> dict[str, SavedEndpoint]:
    used = find_endpoint()
    if used.source is EndpointSource.chosen:
        return {used.name: load_endpoints().endpoints[used.name]}
    if used.source is EndpointSource.local:
        reason = "the server in use runs on this machine and signs its owner in with a file; `klein down` ends it"
    else:
        reason = f"the token in use comes from {config.TOKEN_VARIABLE}; unset that, or name an endpoint"
    raise InvalidInput(what="klein logout", reason=reason)


def whoami(client: Client) -> Output:
    """Show which account the server in use sees, and what your token allows."""
    me, endpoint = client.me.get(), client.endpoint
    credential = me.credential
    return as_details(
        {**me.model_dump(mode="json"), "endpoint": endpoint.name, "url": endpoint.url},
        [
            ("person", me.person.name),
            ("e-mail", me.emails),
            ("admin", "yes" if me.is_admin else None),
            ("by", f"{credential.kind.value} token {credential.name!r}"),
            ("scopes", [scope.value for scope in credential.scopes]),
            ("limited", "to certain projects or missions" if credential.is_limited else None),
            ("until", credential.expires_at),
            ("server", endpoint.url),
            ("endpoint", endpoint.name),
        ],
    )


app = Subcommands("Show and choose the server that commands use.", no_args_is_help=False)
NameArgument = Annotated[str, argument("NAME", autocompletion=options.complete_endpoint)]
_SOURCES = {
    EndpointSource.argument: "it is given as an argument",
    EndpointSource.environment: "KLEINKRAM_URL is set",
    EndpointSource.chosen: "it was chosen, by `klein login` or `klein endpoint use`",
    EndpointSource.local: "it runs on this machine, and no other was chosen",
}


@app.callback(invoke_without_command=True)
def show(ctx: typer.Context, as_json: AsJson = False) -> None:
    """Show which server is in use, and why."""
    if ctx.invoked_subcommand is not None:
        return
    used = find_endpoint()
    why = _SOURCES[used.source]
    saved = next(
        (known for known in load_endpoints().endpoints.values() if (known.url, known.token) == (used.url, used.token)),
        None,
    )
    if as_json:
        fields = {"name": used.name, "url": used.url, "source": used.source.value, "why": why}
        show_json({**fields, **_plain(saved)})
        return
    who, until = _who_until(saved)
    rows = [("endpoint", used.name), ("url", used.url), ("because", why)]
    details([*rows, ("signed in as", who), ("until", until), ("saved in", str(endpoints_file()))])


@app.command("list")
def list_() -> Output:
    """List the saved endpoints, your account on each, and the one in use."""
    saved = load_endpoints().endpoints
    try:
        used = find_endpoint()
    except NotConfigured:
        used = None
    urls = {name: endpoint.url for name, endpoint in saved.items()}
    if used is not None:
        urls.setdefault(used.name, used.url)
    in_use = used.name if used else None
    items = [
        {"name": name, "url": url, "in_use": name == in_use, **_plain(saved.get(name))} for name, url in urls.items()
    ]
    cells = [("*" if name == in_use else "", name, url, *_who_until(saved.get(name))) for name, url in urls.items()]
    return Output({"items": items}, lambda: table(["in use", "name", "url", "who", "until"], cells))


@app.command("add")
def add(
    name: NameArgument,
    url: Annotated[str, argument("URL")],
    token_file: Annotated[
        Path | None, option("--token-file", "F", "Read the token from a file. Default: stdin.")
    ] = None,
) -> Output:
    """Save a server and its token. The first one saved is used."""
    token = options.read_token() if token_file is None else (options.read_text(token_file) or "").strip()
    saved = config.add_endpoint(name, SavedEndpoint(url=url, token=token))
    in_use = saved.current == name
    note(f"Saved {name}." + ("" if in_use else f" `klein endpoint use {name}` chooses it."))
    return Output({"name": name, "url": saved.endpoints[name].url, "in_use": in_use})


@app.command("use")
def use(name: NameArgument) -> Output:
    """Choose the server that commands use."""
    url = config.use_endpoint(name).endpoints[name].url
    note(f"Commands now use {url}.")
    return Output({"name": name, "url": url, "in_use": True})


@app.command("remove")
def remove(name: NameArgument) -> Output:
    """Remove a saved server and its token."""
    saved = config.remove_endpoint(name)
    note(f"Removed {name}.")
    return Output({"name": name, "current": saved.current})


def _plain(endpoint: SavedEndpoint | None) -> dict[str, object]:
    if endpoint is None:
        return {"person": None, "expires_at": None, "expired": None}
    at = endpoint.expires_at
    return {"person": endpoint.person, "expires_at": at.isoformat() if at else None, "expired": _has_expired(endpoint)}


def _who_until(endpoint: SavedEndpoint | None) -> tuple[str | None, str | None]:
    if endpoint is None or endpoint.person is None:
        return None, None
    if endpoint.expires_at is None:
        return endpoint.person, "no end"
    return endpoint.person, moment(endpoint.expires_at) + (" (expired)" if _has_expired(endpoint) else "")


def _has_expired(endpoint: SavedEndpoint) -> bool:
    return endpoint.expires_at is not None and endpoint.expires_at <= datetime.datetime.now(datetime.timezone.utc)
