"""The entry of `klein`: which commands there are, loaded when one is called, and what a failure becomes.

`klein --help` must stay fast, so nothing here imports the SDK, pydantic or rich.
"""

import importlib
import io
import sys
import traceback
from typing import Annotated, Any

import typer
import typer.main

from kleinkram.cli.commands import Group, Noun, closest, print_requests, take_flag

# name -> (module, attribute, the line in `klein --help`)
COMMANDS: dict[str, tuple[str, str, str]] = {
    "up": ("kleinkram.cli.up", "up", "Run Kleinkram on this machine."),
    "down": ("kleinkram.cli.up", "down", "End the Kleinkram that runs on this machine."),
    "doctor": ("kleinkram.cli.up", "doctor", "Say what is wrong, and how to mend it."),
    "backup": ("kleinkram.cli.backup", "app", "Backups of a whole site: create, list, verify, forget."),
    "restore": ("kleinkram.cli.backup", "restore", "Restore a backup into an empty site."),
    "login": ("kleinkram.cli.login", "login", "Sign in to a server."),
    "logout": ("kleinkram.cli.login", "logout", "Sign out, and end the token."),
    "whoami": ("kleinkram.cli.login", "whoami", "Who the server takes you for."),
    "account": ("kleinkram.cli.account", "app", "Your own account: info, unlink."),
    "session": ("kleinkram.cli.session", "app", "Browsers that you are signed in with: list, revoke."),
    "project": ("kleinkram.cli.project", "app", "Projects: create, list, info, update, delete."),
    "mission": ("kleinkram.cli.mission", "app", "Missions: the same, and complete, template."),
    "file": ("kleinkram.cli.file", "app", "Files: the same, and their topics."),
    "access": ("kleinkram.cli.access", "app", "Who may do what: list, grant, revoke."),
    "group": ("kleinkram.cli.group", "app", "Groups of people: create, list, info, add, remove."),
    "person": ("kleinkram.cli.person", "app", "People: list, info, and for admins deactivate."),
    "upload": ("kleinkram.cli.upload", "upload", "Upload files and folders into a mission."),
    "download": ("kleinkram.cli.download", "download", "Download files, verified."),
    "verify": ("kleinkram.cli.verify", "verify", "Compare local files with a mission, or verify the stored bytes."),
    "search": ("kleinkram.cli.search", "search", "Find files, missions or topics."),
    "stats": ("kleinkram.cli.search", "stats", "Hours, bytes, files and messages, grouped."),
    "action": ("kleinkram.cli.action", "app", "What to run on the data: init, run-local, create, run, list, info."),
    "run": ("kleinkram.cli.run", "app", "Runs of actions: list, info, logs, cancel, retry, artifacts, findings."),
    "lineage": ("kleinkram.cli.lineage", "lineage", "Where a file comes from, and what came from it."),
    "runner": ("kleinkram.cli.runner", "app", "Machines that run actions: start, list."),
    "move": ("kleinkram.cli.file", "move", "Move a mission, or files, elsewhere."),
    "rename": ("kleinkram.cli.file", "rename", "Rename a project, mission or file."),
    "token": ("kleinkram.cli.token", "app", "Tokens for scripts, robots and runners: create, list, revoke."),
    "share": ("kleinkram.cli.share", "app", "Links for people without an account: create, list, revoke."),
    "trash": ("kleinkram.cli.trash", "app", "What was deleted: list, restore."),
    "audit": ("kleinkram.cli.audit", "audit", "Who did what, when."),
    "admin": ("kleinkram.cli.admin", "app", "The whole server, for admins: storage, jobs, retry, health."),
    "inspect": ("kleinkram.cli.inspect", "inspect", "Say what is in local recordings, without a server."),
    "sample": ("kleinkram.cli.sample", "sample", "Make a sample mission of realistic recordings."),
    "endpoint": ("kleinkram.cli.endpoint", "app", "Which server commands talk to."),
}

# The original's words for some of them.
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
        return load(name, getattr(importlib.import_module(module), attribute))

    def unknown(self, ctx: typer.Context, args: list[str]) -> str:
        """Return the sentence for a first word that is no command; a verb belongs behind its noun."""
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
    """Return what runs: of a group of commands, or of a function that is one."""
    if isinstance(target, typer.Typer):
        group = typer.main.get_command(target)
        group.name = name
        return group
    single = Noun("")
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


def _print_version(wanted: bool) -> None:
    if wanted:
        import kleinkram

        typer.echo(kleinkram.__version__)
        raise typer.Exit


@app.callback()
def klein(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
    wide: Annotated[
        bool, typer.Option("--wide", help="Show ids and uncut columns in tables; may stand anywhere in a command.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Print requests and tracebacks on stderr; may stand anywhere in a command.")
    ] = False,
) -> None:
    """Keep every recording: upload a mission, know what is in it, find it, get it back intact."""


def main() -> None:
    """Run a command line; a failure is one sentence on stderr and its own exit code (`kleinkram.cli.errors`)."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks a letter must not end a command
            stream.reconfigure(errors="backslashreplace")
    if take_flag(sys.argv, "--wide"):
        from kleinkram.cli.render import show_wide

        show_wide()
    debug = take_flag(sys.argv, "--debug")
    if debug:
        print_requests()
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except Exception as error:
        from kleinkram.cli.errors import explain

        if debug:
            traceback.print_exc()
        exit_code = explain(error)
        if exit_code is None:
            raise
        sys.exit(exit_code)
