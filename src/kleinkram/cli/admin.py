"""`klein admin …`"""

import sys
from collections.abc import Iterator
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import details, moment, note, show_json, table
from kleinkram.cli.units import size
from kleinkram.contract.admin import ScrubRead, ScrubState
from kleinkram.contract.files import BlobState

_DAMAGED = {BlobState.lost.value, BlobState.corrupt.value}


def follow(states: Iterator[ScrubState]) -> ScrubState:
    """Show how far a scrub is, and return how it ended; of a scrub there is at least one state."""
    state = next(states)
    for now in states:
        state = now
        if state.last is not None and state.last.ended_at is None and sys.stderr.isatty():
            note(f"{state.last.compared} objects compared" if state.last.started_at else "waiting for the worker")
    return state


def is_stopped(state: ScrubState) -> bool:
    """Say whether the last scrub did not go through."""
    return state.last is not None and state.last.stopped is not None


def is_damaged(state: ScrubState) -> bool:
    """Say whether any blob is lost or corrupt."""
    return any(row.count for row in state.blobs if row.state in _DAMAGED)


def show_scrub(state: ScrubState) -> None:
    """Print what the last scrub found, and how all blobs are."""
    if state.last is None:
        note("There was no scrub yet.")
    else:
        details(_scrub_results(state.last))
    details(
        [
            ("oldest verification", state.oldest_verification_at),
            ("verified again", f"after {state.again_after_days} days" if state.again_after_days else "only when asked"),
            ("scrubs", f"every {state.every_hours:g} hours" if state.every_hours else "only when asked"),
        ]
    )
    if state.blobs:
        table(["state", "count", "size"], [(row.state, row.count, size(row.size_bytes)) for row in state.blobs])
    if is_damaged(state):
        note("`klein file list --state lost --state corrupt` names them; uploading such a file again mends it.")
    if state.last is not None and state.last.stopped is not None:
        note(state.last.stopped)


def _scrub_results(last: ScrubRead) -> list[tuple[str, object]]:
    ended = "under way" if last.started_at else "waits for the worker"
    if last.ended_at is not None:
        ended = f"{moment(last.ended_at)}{' (stopped)' if last.stopped else ''}"
    return [
        ("began", last.started_at or last.created_at),
        ("ended", ended),
        ("compared", f"{last.compared} objects, {size(last.compared_bytes)}"),
        ("newly lost", last.lost),
        ("newly corrupt", last.corrupt),
        ("there again", last.recovered),
        ("of nobody", last.unknown),
    ]


app = Noun("The whole server, for its admins.")


@app.command("storage")
def storage(as_json: AsJson = False) -> None:
    """Say what the store keeps, by state, and how full its disk is where that is known."""
    with connect() as client:
        status = client.admin.storage()
    if as_json:
        show_json(status)
        return
    details(
        [
            ("kept", size(status.store.used_bytes)),
            ("free", size(status.store.free_bytes)),
            ("disk", size(status.store.disk_bytes)),
        ]
    )
    amounts = [*status.blobs, status.trash, status.uploads, status.marked_for_deletion]
    table(["state", "count", "size"], [(row.state, row.count, size(row.size_bytes)) for row in amounts])
    if status.is_low:
        note("The store is nearly full: uploads will soon be refused.")


@app.command("jobs")
def jobs(as_json: AsJson = False) -> None:
    """Show the queue, the jobs that wait for another attempt, and those that were given up, each with why."""
    with connect() as client:
        status = client.admin.jobs()
    if as_json:
        show_json(status)
        return
    if not status.queue:
        note("Nothing waits, and nothing has failed.")
        return
    table(
        ["job", "state", "count", "oldest"],
        [(row.kind, row.state, row.count, row.oldest_at) for row in status.queue],
    )
    if status.retrying:
        note("")
        table(
            ["number", "job", "for", "tries", "next try", "why the last one failed"],
            [(row.id, row.kind, row.ref, row.attempts, row.next_attempt_at, row.error) for row in status.retrying],
        )
    if status.failed:
        note("")
        table(
            ["number", "job", "for", "tries", "given up", "why"],
            [(row.id, row.kind, row.ref, row.attempts, row.failed_at, row.error) for row in status.failed],
        )
        note("`klein admin retry ID` puts one back into the queue, `klein admin retry --all` all of them.")


@app.command("retry")
def retry(
    job: Annotated[
        int | None, typer.Argument(metavar="[ID]", min=1, show_default=False, help="As `klein admin jobs` shows it.")
    ] = None,
    retry_all: Annotated[bool, typer.Option("--all", help="All jobs that were given up.")] = False,
    as_json: AsJson = False,
) -> None:
    """Put a job that was given up, or all of them, back into the queue."""
    if (job is None) != retry_all:
        raise typer.BadParameter("give the id of one job, or --all", param_hint="ID")
    with connect() as client:
        if job is None:
            count = client.admin.retry_jobs()
            show_json({"retried": count}) if as_json else note(f"{count} jobs are in the queue again.")
            return
        client.admin.retry_job(job)
    if as_json:
        show_json({"retried": job})
    note(f"Job {job} is in the queue again.")


@app.command("scrub")
def scrub(
    last: Annotated[bool, typer.Option("--last", help="Only show the last one, and begin none.")] = False,
    wait: Annotated[bool, typer.Option("--wait/--no-wait", help="Whether to wait for its end.")] = True,
    timeout: Annotated[float, typer.Option("--timeout", metavar="SECONDS", help="How long to wait.")] = 3600.0,
    believe: Annotated[
        bool, typer.Option("--believe", help="Mark as lost whatever is missing, however much. Look first.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Compare what the store lists with the database: what vanished, was cut off, or came back."""
    with connect() as client:
        if not last:
            client.admin.begin_scrub(believe=believe)
        status = follow(client.admin.watch_scrub(timeout_s=timeout)) if wait and not last else client.admin.scrub()
    show_json(status) if as_json else show_scrub(status)
    if not last and (is_stopped(status) or is_damaged(status)):
        raise typer.Exit(ExitCode.server_failed if is_stopped(status) else ExitCode.bytes_differ)


@app.command("health")
def health(as_json: AsJson = False) -> None:
    """Say how database, store and workers are."""
    with connect() as client:
        status = client.admin.health()
    if as_json:
        show_json(status)
        return
    details(
        [
            ("ready", status.not_ready or "yes"),
            *(("warning", entry) for entry in status.warnings),
            ("version", status.version),
            ("tables", status.schema_version),
            ("database", f"PostgreSQL {status.database_version}, {size(status.database_bytes)}"),
            (
                "workers",
                f"{len(status.workers_at)} processes" if len(status.workers_at) != 1 else "1 process",
            ),
            ("heard of", moment(status.worker_last_at) if status.worker_last_at else "never"),
            ("runs", status.runs_problem),
            ("invitations", status.invitation_warning),
            ("store", f"verifies {status.store_checksum}"),
            ("overwrites", "the store refuses them" if status.store_writes_once else "the store takes them"),
            ("pages", "may send to the store" if status.store_takes_pages else "may not send to the store"),
            ("clocks apart", f"{status.clock_skew_s:.2f} s"),
        ]
    )
