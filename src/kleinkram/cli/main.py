"""The entry point `klein`: its commands, each imported when called, and its handling of failures.

`klein --help` must stay fast, so nothing here imports the SDK, pydantic or rich.
"""

import contextlib
import importlib
import io
import logging
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer
import typer.main

from kleinkram import traces
from kleinkram.cli.commands import Group, Subcommands, closest, print_requests, take_flag

# name -> (module of kleinkram.cli, attribute, the line in `klein --help`)
COMMANDS: dict[str, tuple[str, str, str]] = {
    "up": ("instance", "up", "Run Kleinkram on this machine."),
    "down": ("instance", "down", "Stop the Kleinkram that runs on this machine."),
    "doctor": ("instance", "doctor", "Check the Kleinkram on this machine, and show how to fix problems."),
    "backup": ("instance", "app", "Create, list, verify and prune backups of a whole instance."),
    "restore": ("instance", "restore", "Restore a backup to an empty instance."),
    "login": ("login", "login", "Sign in to a server."),
    "logout": ("login", "logout", "Sign out, and revoke the token."),
    "whoami": ("login", "whoami", "Show your account and token."),
    "account": ("account", "app", "Show your own account and how you sign in."),
    "session": ("account", "session_app", "Manage the browsers that you are signed in with."),
    "project": ("project", "app", "Manage projects."),
    "mission": ("mission", "app", "Manage missions."),
    "file": ("file", "app", "Manage files, and show their topics."),
    "event": ("mission_events", "app", "Mark moments and spans of missions, and list them."),
    "access": ("people", "access_app", "Manage the rights on a project or a mission."),
    "group": ("people", "group_app", "Manage groups of people."),
    "person": ("people", "person_app", "Manage people."),
    "upload": ("transfer", "upload", "Upload files and folders to a mission."),
    "download": ("transfer", "download", "Download files, verified."),
    "cut": ("cut", "cut", "Write topics, or a time range, of recordings as one MCAP."),
    "export": ("export", "export", "Write topics of recordings as Parquet, CSV or images."),
    "verify": ("transfer", "verify", "Compare local files with a mission, or verify the stored bytes."),
    "search": ("search", "search", "Find files, missions or topics."),
    "stats": ("search", "stats", "Count hours, bytes, files and messages by group."),
    "action": ("action", "app", "Manage, try out and run actions."),
    "run": ("run", "app", "Manage runs of actions, and get their results."),
    "metrics": ("metrics", "app", "Show and compare the metrics that runs reported."),
    "lineage": ("search", "lineage", "Show where a file comes from, and what was created from it."),
    "runner": ("runner", "app", "Run and list runners: machines that run actions."),
    "move": ("file", "move", "Move a mission or files."),
    "rename": ("file", "rename", "Rename a project, mission or file."),
    "token": ("account", "token_app", "Manage tokens of scripts, robots and runners."),
    "share": ("account", "share_app", "Manage links for people without an account."),
    "trash": ("admin", "trash_app", "List and restore what was deleted."),
    "audit": ("admin", "audit", "Show who did what, when."),
    "admin": ("admin", "app", "Show and repair the whole server; for admins."),
    "inspect": ("recordings", "inspect", "Show what is in local recordings, without a server."),
    "convert": ("convert", "convert", "Convert, recompress or repair local recordings: to MCAP, or to ROS 1 bags."),
    "check": ("check", "check", "Check local recordings by the rules of checks.yaml, without a server."),
    "checks": ("check", "app", "Make checks.yaml, the rules that recordings must pass, and manage that of a project."),
    "sample": ("recordings", "sample", "Create a sample mission of realistic recordings."),
    "endpoint": ("login", "app", "Show and choose the server that commands use."),
}

# Their processes export traces of their own.
_LONG_RUNNING = frozenset({"up", "runner"})
# Names of these commands in the original Kleinkram.
ALIASES = {"template": "action", "execution": "run"}
# Verbs that people type first, as in `klein list projects`.
_VERBS = frozenset({"create", "list", "info", "update", "delete", "complete", "retry", "cancel", "logs"})


class LazyCommands(Group):
    """The group of all commands, each imported when it is called."""

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]  # the same class, re-exported
        """Return the names in the order of the help."""
        return [*COMMANDS]

    def get_command(self, ctx: typer.Context, cmd_name: str) -> Any:  # type: ignore[override]  # as above
        """Import a command; None where there is none of that name."""
        name = ALIASES.get(cmd_name, cmd_name)
        if name not in COMMANDS:
            return None
        module, attribute, _ = COMMANDS[name]
        return load(name, getattr(importlib.import_module(f"kleinkram.cli.{module}"), attribute))

    def unknown(self, ctx: typer.Context, args: list[str]) -> str:
        """Return the message for an unknown command; for a verb, it names the noun that comes first."""
        verb, *rest = args
        if verb not in _VERBS:
            return super().unknown(ctx, args)
        noun = closest(rest[0].removesuffix("s"), COMMANDS) if rest else None
        return f"No such command: {verb!r}. The noun comes first: `klein {noun or 'mission'} {verb}`."

    def format_commands(self, ctx: typer.Context, formatter: Any) -> None:  # type: ignore[override]  # as above
        """Write the list of commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, _, line) in COMMANDS.items()])


def load(name: str, target: Any) -> Any:
    """Return the click command of a group of commands or of a function."""
    if isinstance(target, typer.Typer):
        group = typer.main.get_command(target)
        group.name = name
        return group
    single = Subcommands("")
    single.command(name)(target)
    return typer.main.get_command(single)


app = typer.Typer(
    name="klein",
    cls=LazyCommands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(is_requested: bool) -> None:
    if is_requested:
        import kleinkram

        typer.echo(kleinkram.__version__)
        raise typer.Exit


@app.callback()
def klein(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
    wide: Annotated[
        bool, typer.Option("--wide", help="Show ids and uncut columns in tables; can be anywhere in a command.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Print requests and tracebacks on stderr; can be anywhere in a command.")
    ] = False,
) -> None:
    """Keep every recording: upload a mission, know what is in it, find it, get it back intact."""


@contextlib.contextmanager
def _traced(arguments: Sequence[str]) -> Iterator[None]:
    """Run a command as a span, below the one in `TRACEPARENT`; only if the environment asks for traces."""
    name = next((argument for argument in arguments if argument in COMMANDS), "")
    if name in _LONG_RUNNING or traces.endpoint() is None:
        yield
        return
    for name_of_logger in ("opentelemetry", "kleinkram.traces"):  # a collector that is away does not concern users
        logging.getLogger(name_of_logger).setLevel(logging.CRITICAL)
    traces.start("klein")
    try:
        with traces.span(f"klein {name}".strip(), parent=os.environ.get("TRACEPARENT")):
            yield
    finally:
        traces.stop()


def main() -> None:
    """Run a command line; a failure is one sentence on stderr and its own exit code (`kleinkram.cli.errors`)."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a character that the terminal cannot encode must not end a command
            stream.reconfigure(errors="backslashreplace")
    if take_flag(sys.argv, "--wide"):
        from kleinkram.cli.render import show_wide

        show_wide()
    debug = take_flag(sys.argv, "--debug")
    if debug:
        print_requests()
    try:
        with _traced(sys.argv[1:]):
            exit_code = app(standalone_mode=False) or 0
        sys.exit(exit_code)
    except Exception as error:
        from kleinkram.cli.errors import explain

        if debug:
            traceback.print_exc()
        exit_code = explain(error)
        if exit_code is None:
            raise
        sys.exit(exit_code)
