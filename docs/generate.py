"""Generate the reference: OpenAPI, commands, settings, metrics, values of the chart and others, and plots.

`--check` compares.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from chart import chart_pages
from fastapi.routing import APIRoute
from plots import plots
from pydantic_core import PydanticUndefined

from kleinkram.checks.document import json_schema
from kleinkram.cli.errors import EXIT_CODES, RECORDING_CODES, ExitCode
from kleinkram.cli.main import app as cli
from kleinkram.contract.access import Scope
from kleinkram.metric_definitions import DEFINITIONS, MetricDefinition
from kleinkram.server.access.operations import OPEN_PAGES, OPERATIONS, Permission, ResourceKind
from kleinkram.server.app import ROUTERS, create_app
from kleinkram.server.settings import Settings

_HERE = Path(__file__).parent
_ENVIRONMENT = {
    "database_url": "postgresql://kleinkram_serve@localhost/kleinkram",
    "s3_internal_url": "http://localhost:8333",
    "s3_access_key": "key",
    "s3_secret_key": "secret",
}


def main() -> int:
    """Write the generated pages; with `--check`, name those that are not up to date."""
    pages = {
        _HERE / "openapi.json": openapi(),
        _HERE / "reference" / "cli.md": cli_reference(),
        _HERE / "reference" / "settings.md": settings_reference(),
        _HERE / "reference" / "operations.md": operations_reference(),
        _HERE / "reference" / "prometheus.md": metrics_reference(),
        _HERE / "reference" / "checks.schema.json": json.dumps(json_schema(), indent=1, ensure_ascii=False) + "\n",
        **{_HERE / "plots" / name: text for name, text in plots().items()},
        **chart_pages(),
    }
    stale = [path for path, text in pages.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    if "--check" in sys.argv:
        for path in stale:
            sys.stderr.write(f"{path.relative_to(_HERE.parent)} is not up to date; run `make generated`\n")
        return 1 if stale else 0
    for path in stale:
        path.parent.mkdir(exist_ok=True)
        path.write_text(pages[path], encoding="utf-8")
    return 0


def openapi() -> str:
    """Return the API's description, the same on every machine."""
    schema = create_app(Settings.model_validate(_ENVIRONMENT)).openapi()
    return json.dumps(schema, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def settings_reference() -> str:
    """Return every setting of the server with its default."""
    lines = [
        "# Settings",
        "",
        "Environment variables of the server's processes, read at start. `klein up` sets them itself; set them if you",
        "use your own PostgreSQL and S3 ([production setup](../running.md)). This page is generated.",
        "",
        "| variable | default | meaning |",
        "|---|---|---|",
    ]
    for name, field in sorted(Settings.model_fields.items()):
        default = "required" if field.default is PydanticUndefined else f"`{field.default}`"
        lines.append(f"| `KLEINKRAM_{name.upper()}` | {default} | {field.description} |")
    return "\n".join(lines) + "\n"


def metrics_reference() -> str:
    """Return every metric with its type, labels and meaning."""
    lines = [
        "# Prometheus metrics",
        "",
        "The metrics of the server ([monitoring](../running.md#monitor)) and of [runners](../runner.md#metrics). This",
        "page is generated.",
        "",
        "*From* says which processes have a metric. `instance`: one API or worker process at a time reports the whole",
        "installation; query such metrics with `max without (instance, job) (...)`, because the process may change.",
        "They are absent while the database is away. Every process also has the `process_*` metrics of Prometheus'",
        "clients: CPU time, memory, start time and open files.",
        "",
        "No label contains a name or an id of an object, and clients cannot add values. Counters start at 0 with their",
        "process.",
        "",
        "| metric | type | labels | from | meaning |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| `{one.name}` | {one.kind.value} | {_labels(one)} | {one.source.value} | {one.meaning} |"
        for one in DEFINITIONS
    ]
    return "\n".join(lines) + "\n"


def _labels(definition: MetricDefinition) -> str:
    if not definition.values:
        return ", ".join(f"`{label}`" for label in definition.labels)
    *others, last = definition.labels
    return ", ".join([*(f"`{label}`" for label in others), f"`{last}`: {', '.join(definition.values)}"])


def operations_reference() -> str:
    """Return the required permissions of every route, and the public pages."""
    lines = [
        "# Operations",
        "",
        "The permissions that each operation of the API requires: the right and its object, the scope of a token, and",
        "who else may use it. Errors are in the [OpenAPI description](../openapi.json).",
        "This page is generated.",
        "",
        "| operation | route | right | token scope | also for |",
        "|---|---|---|---|---|",
    ]
    routes = {
        route.operation_id: f"`{'/'.join(sorted(route.methods or ()))} {route.path}`"
        for router in ROUTERS
        for route in router.routes
        if isinstance(route, APIRoute)
    }
    for name, need in OPERATIONS.items():
        route = routes.get(name, "part of another operation")
        lines.append(f"| {name} | {route} | {_right(need)} | {_scopes(need)} | {_others(need)} |")
    lines += ["", "Public pages, without any data of people:", "", "| page | content |", "|---|---|"]
    lines += [f"| `{path}` | {what} |" for path, what in sorted(OPEN_PAGES.items())]
    return "\n".join(lines) + "\n"


def _right(need: Permission) -> str:
    if need.on is ResourceKind.server:
        return "admin"
    if need.right is None:
        return "—"
    resource_type = "each object in the result" if need.on is ResourceKind.visible else f"the {need.on.value}"
    return f"{need.right.value} on {resource_type}"


def _scopes(need: Permission) -> str:
    if need.browsers:
        return "none: a signed-in browser"
    scopes = "any" if len(need.scopes) == len(Scope) else " or ".join(sorted(scope.value for scope in need.scopes))
    return f"{scopes}, without limits" if need.unrestricted else scopes


def _others(need: Permission) -> str:
    guests = "everybody" if need.on is ResourceKind.none else "guests, for public or shared objects"
    return ", ".join([guests] * need.guests + ["runners"] * need.runners)


def cli_reference() -> str:
    """Return every command with its arguments and options."""
    root = typer.main.get_command(cli)
    lines = ["# Commands", "", "The output of `klein --help` for all commands. This page is generated.", ""]
    for path, command in _commands(root, ["klein"]):
        lines += _section(path, command)
    return "\n".join(lines + _exit_codes()).rstrip() + "\n"


def _exit_codes() -> list[str]:
    lines = [
        "## Exit codes",
        "",
        "0 is success. Scripts may rely on these numbers.",
        "",
        "| code | name | failures |",
        "|---|---|---|",
    ]
    for code in ExitCode:
        errors = [error for error, its in (EXIT_CODES | RECORDING_CODES).items() if its is code]
        failures = ", ".join(sorted(error.__name__ for error in errors))
        lines.append(f"| {code.value} | {code.name.replace('_', ' ')} | {failures} |")
    return lines


def _commands(command: Any, path: list[str]) -> Iterator[tuple[list[str], Any]]:
    # Any: Typer may use its own copy of click.
    if not hasattr(command, "list_commands"):
        yield path, command
        return
    context = command.context_class(command, info_name=path[-1])
    for name in sorted(command.list_commands(context)):
        child = command.get_command(context, name)
        if child is not None and not child.hidden:
            yield from _commands(child, [*path, name])


def _section(path: list[str], command: Any) -> list[str]:
    context = command.context_class(command, info_name=" ".join(path))
    usage = " ".join([*path, *command.collect_usage_pieces(context)])
    lines = [f"## `{' '.join(path)}`", "", f"    {usage}", "", (command.help or "").strip(), ""]
    rows = [record for parameter in command.get_params(context) if (record := parameter.get_help_record(context))]
    rows = [(names, text) for names, text in rows if "--help" not in names]
    if rows:
        lines += ["| option | meaning |", "|---|---|"]
        lines += ["| `{}` | {} |".format(*(" ".join(cell.split()).replace("|", "\\|") for cell in row)) for row in rows]
        lines.append("")
    return lines


if __name__ == "__main__":
    sys.exit(main())
