"""Following a run: its log as it comes, and a line that says what it is at. Always on stderr."""

import contextlib
import sys
import threading
import uuid
from collections.abc import Iterator
from typing import Protocol

import typer
from rich.console import Console
from rich.markup import escape as escape_markup
from rich.status import Status
from rich.text import Text

from kleinkram.cli.errors import ExitCode
from kleinkram.cli.log_view import harmless, write_log
from kleinkram.cli.render import escape, note
from kleinkram.cli.run_view import action_name, mission_name, standing
from kleinkram.client import Client
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.runs import RunDetail, RunRead, RunState

# What is left of a log once its run is over comes within moments.
_REST_OF_LOG_S = 30.0


class View(Protocol):
    """Where a run is shown while it lasts."""

    def seen(self, run: RunDetail) -> None:
        """The run was looked at."""

    def wrote(self, text: str) -> None:
        """The run wrote something."""


class Lines:
    """A line whenever the run comes a step further, and its log as it is."""

    def __init__(self) -> None:
        self._last = ""

    def seen(self, run: RunDetail) -> None:
        """Say where the run is, if that is new."""
        now = run.state.value if run.state is RunState.running else standing(run)
        if now != self._last and run.ended_at is None:
            note(f"{now}{_where(run)}")
        self._last = now

    def wrote(self, text: str) -> None:
        """Pass it on."""
        write_log(text, sys.stderr)


class Live:
    """The log, and below it a line that says what the run is at."""

    def __init__(self, console: Console, status: Status) -> None:
        self._console = console
        self._status = status

    def seen(self, run: RunDetail) -> None:
        """Say where the run is."""
        self._status.update(escape_markup(escape(f"{standing(run)}{_where(run)}")))

    def wrote(self, text: str) -> None:
        """Show it above the line."""
        self._console.print(Text.from_ansi(harmless(text.removesuffix("\n"))), soft_wrap=True)


def follow(client: Client, run_id: uuid.UUID) -> RunDetail:
    """Show a run until it is over, and return it. Ctrl-C ends the following alone: the run goes on.

    Raises:
        typer.Exit: by Ctrl-C, with its exit code; says how to go on.
    """
    try:
        with _viewing() as view:
            return _follow(client, run_id, view)
    except KeyboardInterrupt:
        note(f"The run goes on. `klein run logs -f {run_id}` follows it again, `klein run cancel {run_id}` ends it.")
        raise typer.Exit(ExitCode.interrupted) from None


def _follow(client: Client, run_id: uuid.UUID, view: View) -> RunDetail:
    failures: list[KleinkramError] = []

    def show_log() -> None:
        attempt = 0
        try:
            for piece in client.runs.log(run_id, follow=True):
                if attempt and piece.attempt != attempt:
                    note(f"Its runner was lost: attempt {piece.attempt} begins anew.")
                attempt = piece.attempt
                view.wrote(piece.text)
        except KleinkramError as error:
            failures.append(error)

    # Ends with the process, should somebody stop following in the middle of a request that waits.
    log = threading.Thread(target=show_log, daemon=True)
    log.start()
    run = client.runs.wait(run_id, seen=view.seen)
    log.join(timeout=_REST_OF_LOG_S)
    for failure in failures:
        raise failure
    return run


@contextlib.contextmanager
def _viewing() -> Iterator[View]:
    if not sys.stderr.isatty():
        yield Lines()
        return
    console = Console(stderr=True)
    with console.status("asking") as status:
        yield Live(console, status)


def heading(run: RunRead) -> str:
    """Return what stands above the log of one of several runs."""
    return f"— {mission_name(run)}: {action_name(run.action)}, run {run.id}"


def _where(run: RunDetail) -> str:
    return f" on {run.runner}" if run.runner and run.state is not RunState.queued else ""


def last_word(run: RunDetail) -> None:
    """Say how a run ended, where its message is worth more than its state, and what of its words was not taken."""
    for problem in run.problems:
        note(problem)
    if run.reuses_id is not None:
        note(f"The results are those of the run {run.reuses_id}: same version, parameters, inputs. --force runs anew.")
    if run.state is not RunState.done:
        note(f"{run.state.value}: {run.message}" if run.message else run.state.value)
