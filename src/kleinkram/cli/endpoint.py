"""`klein endpoint …`"""

import sys
from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli.options import AsJson, read_text
from kleinkram.cli.render import details, note, show_json, table
from kleinkram.client.config import (
    EndpointSource,
    add_endpoint,
    endpoints_file,
    find_endpoint,
    load_endpoints,
    remove_endpoint,
    use_endpoint,
)
from kleinkram.client.errors import NotConfigured

app = typer.Typer(
    help="Which server commands talk to, and why.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

_WHY = {
    EndpointSource.argument: "it was given",
    EndpointSource.environment: "KLEINKRAM_URL says so",
    EndpointSource.chosen: "it was chosen with `klein endpoint use`",
    EndpointSource.local: "it runs on this machine, and no other was chosen",
}

NameArgument = Annotated[str, typer.Argument(metavar="NAME", show_default=False)]


@app.callback(invoke_without_command=True)
def show(ctx: typer.Context, as_json: AsJson = False) -> None:
    """Show which server is in use, and why."""
    if ctx.invoked_subcommand is not None:
        return
    endpoint = find_endpoint()
    why = _WHY[endpoint.source]
    if as_json:
        show_json({"name": endpoint.name, "url": endpoint.url, "source": endpoint.source.value, "why": why})
        return
    details([("endpoint", endpoint.name), ("url", endpoint.url), ("because", why), ("saved in", str(endpoints_file()))])


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the saved endpoints, and the one in use."""
    saved = load_endpoints()
    try:
        used = find_endpoint()
    except NotConfigured:
        used = None
    rows = {name: endpoint.url for name, endpoint in saved.endpoints.items()}
    if used is not None:
        rows.setdefault(used.name, used.url)
    in_use = used.name if used else None
    if as_json:
        show_json({"items": [{"name": name, "url": url, "in_use": name == in_use} for name, url in rows.items()]})
        return
    table(["in use", "name", "url"], [("*" if name == in_use else "", name, url) for name, url in rows.items()])


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
    saved = add_endpoint(name, url, _token(token_file))
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
    if file is not None:
        return (read_text(file) or "").strip()
    if sys.stdin.isatty():
        return str(typer.prompt("Token", hide_input=True, err=True)).strip()
    return sys.stdin.readline().strip()
