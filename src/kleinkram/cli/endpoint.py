"""`klein endpoint …`"""

import datetime
from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, complete_endpoint, read_text, read_token
from kleinkram.cli.render import details, moment, note, show_json, table
from kleinkram.client.config import (
    EndpointSource,
    SavedEndpoint,
    add_endpoint,
    endpoints_file,
    find_endpoint,
    load_endpoints,
    remove_endpoint,
    use_endpoint,
)
from kleinkram.client.errors import NotConfigured

app = Noun("Which server commands talk to, and why.", no_args_is_help=False)

_WHY = {
    EndpointSource.argument: "it was given",
    EndpointSource.environment: "KLEINKRAM_URL says so",
    EndpointSource.chosen: "it was chosen, by `klein login` or `klein endpoint use`",
    EndpointSource.local: "it runs on this machine, and no other was chosen",
}

NameArgument = Annotated[str, typer.Argument(metavar="NAME", show_default=False, autocompletion=complete_endpoint)]


@app.callback(invoke_without_command=True)
def show(ctx: typer.Context, as_json: AsJson = False) -> None:
    """Show which server is in use, and why."""
    if ctx.invoked_subcommand is not None:
        return
    endpoint = find_endpoint()
    why = _WHY[endpoint.source]
    known = _known(endpoint.url, endpoint.token)
    if as_json:
        told = {"name": endpoint.name, "url": endpoint.url, "source": endpoint.source.value, "why": why}
        show_json({**told, **_told(known)})
        return
    who, until = _who_until(known)
    place = [("endpoint", endpoint.name), ("url", endpoint.url), ("because", why)]
    details([*place, ("signed in as", who), ("until", until), ("saved in", str(endpoints_file()))])


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the saved endpoints, who one is on each and until when, and the one in use."""
    saved = load_endpoints().endpoints
    try:
        used = find_endpoint()
    except NotConfigured:
        used = None
    urls = {name: endpoint.url for name, endpoint in saved.items()}
    if used is not None:
        urls.setdefault(used.name, used.url)
    in_use = used.name if used else None
    if as_json:
        rows = [
            {"name": name, "url": url, "in_use": name == in_use, **_told(saved.get(name))} for name, url in urls.items()
        ]
        show_json({"items": rows})
        return
    table(
        ["in use", "name", "url", "who", "until"],
        [("*" if name == in_use else "", name, url, *_who_until(saved.get(name))) for name, url in urls.items()],
    )


@app.command("add")
def add(
    name: NameArgument,
    url: Annotated[str, typer.Argument(metavar="URL", show_default=False)],
    token_file: Annotated[
        Path | None, typer.Option("--token-file", metavar="F", help="File with the token; else it is read from stdin.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Save a server and the token for it. The first one saved is chosen."""
    saved = add_endpoint(name, SavedEndpoint(url=url, token=_token(token_file)))
    if as_json:
        show_json({"name": name, "url": saved.endpoints[name].url, "in_use": saved.current == name})
    note(f"Saved {name}." + ("" if saved.current == name else f" `klein endpoint use {name}` chooses it."))


@app.command("use")
def use(name: NameArgument, as_json: AsJson = False) -> None:
    """Choose the server that commands talk to."""
    saved = use_endpoint(name)
    if as_json:
        show_json({"name": name, "url": saved.endpoints[name].url, "in_use": True})
    note(f"From now on commands talk to {saved.endpoints[name].url}.")


@app.command("remove")
def remove(name: NameArgument, as_json: AsJson = False) -> None:
    """Forget a server and its token."""
    saved = remove_endpoint(name)
    if as_json:
        show_json({"name": name, "current": saved.current})
    note(f"Forgot {name}.")


def _token(file: Path | None) -> str:
    return read_token() if file is None else (read_text(file) or "").strip()


def _known(url: str, token: str | None) -> SavedEndpoint | None:
    saved = load_endpoints().endpoints.values()
    return next((endpoint for endpoint in saved if (endpoint.url, endpoint.token) == (url, token)), None)


def _told(endpoint: SavedEndpoint | None) -> dict[str, object]:
    if endpoint is None:
        return {"person": None, "expires_at": None, "expired": None}
    at = endpoint.expires_at
    return {"person": endpoint.person, "expires_at": at.isoformat() if at else None, "expired": _has_expired(endpoint)}


def _who_until(endpoint: SavedEndpoint | None) -> tuple[str | None, str | None]:
    if endpoint is None or endpoint.person is None:
        return None, None
    if endpoint.expires_at is None:
        return endpoint.person, "no end"
    ending = " (expired)" if _has_expired(endpoint) else ""
    return endpoint.person, moment(endpoint.expires_at) + ending


def _has_expired(endpoint: SavedEndpoint) -> bool:
    return endpoint.expires_at is not None and endpoint.expires_at <= datetime.datetime.now(datetime.timezone.utc)
