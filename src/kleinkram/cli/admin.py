"""`klein admin …`, `klein trash …` and `klein audit`: the state of the server, deleted objects, the audit log."""

import json
import sys
from collections.abc import Iterable, Iterator
from typing import Annotated

import typer

from kleinkram.cli.commands import AsJson, Subcommands, Text, argument, flag, option
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.filters import filter_of, ids_of
from kleinkram.cli.options import Limit, MissionsOption, ProjectsOption
from kleinkram.cli.render import Output, as_details, as_table, details, line, moment, note, plain, table
from kleinkram.cli.units import count, parse_time, size
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.admin import CapacityForecast, CapacityUnit, ScrubState, StateAmount
from kleinkram.contract.audit import AuditFilter, AuditRead
from kleinkram.contract.files import BlobState
from kleinkram.contract.names import is_id
from kleinkram.contract.projects import TrashRead, TrashResourceType

_DAMAGED = {BlobState.lost.value, BlobState.corrupt.value}
_AUDIT_ROWS = 100

app = Subcommands("Show and repair the whole server; for admins.")


@app.command("storage")
def storage(client: Client) -> Output:
    """Show what the store contains, by state, and how full its disk is if known."""
    status = client.admin.storage()

    def show() -> None:
        store = status.store
        details([("used", size(store.used_bytes)), ("free", size(store.free_bytes)), ("disk", size(store.disk_bytes))])
        _show_amounts([*status.blobs, status.trash, status.uploads, status.marked_for_deletion])
        if status.is_low:
            note("The store is nearly full: uploads will soon be refused.")

    return Output(status, show)


def _show_amounts(amounts: Iterable[StateAmount]) -> None:
    table(["state", "count", "size"], [(row.state, row.count, size(row.size_bytes)) for row in amounts])


@app.command("jobs")
def jobs(client: Client) -> Output:
    """Show the job queue, the jobs that will be retried, and those that failed permanently, with reasons."""
    status = client.admin.jobs()

    def show() -> None:
        if not status.queue:
            note("No job is queued or has failed.")
            return
        amounts = [(row.kind, row.state, row.count, row.oldest_at) for row in status.queue]
        table(["job", "state", "count", "oldest"], amounts)
        if status.retrying:
            note("")
            table(
                ["number", "job", "for", "tries", "next try", "why the last one failed"],
                [(row.id, row.kind, row.ref, row.attempts, row.next_attempt_at, row.error) for row in status.retrying],
            )
        if status.failed:
            note("")
            table(
                ["number", "job", "for", "tries", "failed", "reason"],
                [(row.id, row.kind, row.ref, row.attempts, row.failed_at, row.error) for row in status.failed],
            )
            note("`klein admin retry ID` requeues one, `klein admin retry --all` all of them.")

    return Output(status, show)


@app.command("retry")
def retry(
    client: Client,
    job: Annotated[int | None, argument("[ID]", "Number of the job, as in `klein admin jobs`.", min=1)] = None,
    retry_all: Annotated[bool, flag("--all", "Retry all jobs that failed permanently.")] = False,
) -> Output:
    """Requeue a job that failed permanently, or all of them."""
    if (job is None) != retry_all:
        raise typer.BadParameter("specify the number of a job or --all", param_hint="ID")
    if job is None:
        retried = client.admin.retry_jobs()
        return Output({"retried": retried}, f"Requeued {count(retried, 'job')}.")
    client.admin.retry_job(job)
    note(f"Job {job} is in the queue again.")
    return Output({"retried": job})


@app.command("scrub")
def scrub(
    client: Client,
    last: Annotated[bool, flag("--last", "Show the last scrub, and start none.")] = False,
    wait: Annotated[bool, flag("--wait/--no-wait", "Wait for its end.")] = True,
    timeout: Annotated[float, option("--timeout", "SECONDS", "The maximum time to wait.")] = 3600.0,
    accept_losses: Annotated[
        bool, flag("--accept-losses", "Mark all missing objects as lost, however many. Check the store first.")
    ] = False,
) -> Output:
    """Compare the store with the database, and show which objects vanished, were truncated, or came back."""
    if not last:
        client.admin.begin_scrub(accept_losses=accept_losses)
    status = follow(client.admin.watch_scrub(timeout_s=timeout)) if wait and not last else client.admin.scrub()
    exit_code = 0
    if not last and status.last is not None and status.last.aborted_reason is not None:
        exit_code = ExitCode.server_failed
    elif not last and is_damaged(status):
        exit_code = ExitCode.bytes_differ
    return Output(status, lambda: show_scrub(status), exit_code)


def follow(states: Iterator[ScrubState]) -> ScrubState:
    """Show the progress of a scrub, and return its last state."""
    state = next(states)
    for now in states:
        state = now
        if state.last is not None and state.last.ended_at is None and sys.stderr.isatty():
            note(f"{state.last.compared} objects compared" if state.last.started_at else "waiting for the worker")
    return state


def is_damaged(state: ScrubState) -> bool:
    """Return whether any blob is lost or corrupt."""
    return any(row.count for row in state.blobs if row.state in _DAMAGED)


def show_scrub(state: ScrubState) -> None:
    """Print the results of the last scrub, and the states of all blobs."""
    last = state.last
    if last is None:
        note("There was no scrub yet.")
    else:
        ended = "under way" if last.started_at else "waiting for the worker"
        if last.ended_at is not None:
            ended = f"{moment(last.ended_at)}{' (stopped)' if last.aborted_reason else ''}"
        details(
            [
                ("began", last.started_at or last.created_at),
                ("ended", ended),
                ("compared", f"{last.compared} objects, {size(last.compared_bytes)}"),
                ("newly lost", last.lost),
                ("newly corrupt", last.corrupt),
                ("recovered", last.recovered),
                ("unknown", last.unknown),
            ]
        )
    details(
        [
            ("oldest verification", state.oldest_verification_at),
            ("verified again", f"after {state.again_after_days} days" if state.again_after_days else "only when asked"),
            ("scrubs", f"every {state.every_hours:g} hours" if state.every_hours else "only when asked"),
        ]
    )
    if state.blobs:
        _show_amounts(state.blobs)
    if is_damaged(state):
        note("`klein file list --state lost --state corrupt` lists them; upload such a file again to repair it.")
    if last is not None and last.aborted_reason is not None:
        note(last.aborted_reason)


@app.command("health")
def health(client: Client) -> Output:
    """Show the state of database, store and workers."""
    status = client.admin.health()
    workers = len(status.workers_at)
    return as_details(
        status,
        [
            ("ready", status.not_ready or "yes"),
            *(("warning", entry) for entry in status.warnings),
            ("version", status.version),
            ("tables", status.schema_version),
            ("database", f"PostgreSQL {status.database_version}, {size(status.database_bytes)}"),
            ("workers", f"{workers} processes" if workers != 1 else "1 process"),
            ("last heartbeat", moment(status.worker_last_at) if status.worker_last_at else "never"),
            ("runs", status.runs_problem),
            ("invitations", status.invitation_warning),
            ("store", f"verifies {status.store_checksum}"),
            ("overwrites", "refused by the store" if status.store_refuses_overwrites else "accepted by the store"),
            ("browser uploads", "allowed" if status.store_allows_browser_uploads else "refused by the store"),
            ("clock difference", f"{status.clock_skew_s:.2f} s"),
        ],
    )


@app.command("status")
def status(client: Client) -> Output:
    """Show what needs an admin, what is full, and when it will be. The exit code is 1 if there is a problem."""
    state = client.admin.status()

    def show() -> None:
        for item in state.items:
            line(f"{item.severity.value.upper():7} {item.subject}: {item.message} {item.remedy}".rstrip())
        if not state.items:
            line("Healthy: nothing needs your attention.")
        details(
            [
                ("version", state.version),
                ("stored", size(state.stored_bytes)),
                ("added", f"{size(state.stored_bytes_per_day)} a day, mean of the last 30 days"),
            ]
        )
        if state.capacities:
            table(["what", "used", "limit", "a day", "full on"], map(_capacity_cells, state.capacities))

    return Output(state, show, 0 if state.is_healthy else ExitCode.server_failed)


def _capacity_cells(row: CapacityForecast) -> tuple[object, ...]:
    def amount(number: int) -> str | None:
        return size(number) if row.unit is CapacityUnit.bytes else count(number, "file")

    name = "the store" if row.project is None else f"quota of {row.project.name}"
    full_on = "-" if row.full_at is None else f"{row.full_at:%Y-%m-%d}"
    return name, amount(row.used), amount(row.limit), amount(row.per_day), full_on


trash_app = Subcommands("List and restore what was deleted in the last 30 days.")
ResourceTypeOption = Annotated[TrashResourceType | None, option("--type", None, "Select by kind.")]


@trash_app.command("list")
def list_trash(client: Client, resource_type: ResourceTypeOption = None) -> Output:
    """List what can be restored."""
    headers = ["type", "name", "from", "files", "size", "deleted", "by", "purged after", "id"]
    return as_table(client.trash.list(resource_type), headers, _trash_cells)


def _trash_cells(row: TrashRead) -> tuple[object, ...]:
    content = (row.file_count, size(row.size_bytes))
    deleted = (row.deleted_at, row.deleted_by.name, row.purged_after)
    return row.resource_type.value, row.name, row.location, *content, *deleted, row.id


@trash_app.command("restore")
def restore(
    client: Client,
    refs: Annotated[list[str], argument("NAME", "Names or ids.")],
    resource_type: ResourceTypeOption = None,
) -> Output:
    """Restore deleted projects, missions and files to where they were."""
    rows = [client.trash.get(ref, resource_type=resource_type) for ref in refs]
    for row in rows:
        client.trash.restore(row.resource_type, row.id)
        note(f"Restored the {row.resource_type.value} {row.name}.")
    return Output({"items": rows})


def audit(
    client: Client,
    person: Annotated[Text, option("--person", "PERSON", "Select by person: name or id.")] = None,
    token: Annotated[Text, option("--token", "TOKEN", "Select by token: name or id.")] = None,
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    resource_type: Annotated[Text, option("--type", None, "Select by kind: project, mission, file, …")] = None,
    resource_id: Annotated[Text, option("--id", "ID", "Select by id of the object.")] = None,
    operation: Annotated[Text, option("--operation", "GLOB", "Select by operation, such as 'file.*'.")] = None,
    since: Annotated[Text, option("--since", "TIME", "Select entries from this time on.")] = None,
    until: Annotated[Text, option("--until", "TIME", "Select entries before this time.")] = None,
    as_admin: Annotated[bool, flag("--as-admin", "Select only what required admin rights.")] = False,
    limit: Limit = None,
    jsonl: Annotated[bool, flag("--export --jsonl", "Print all that match as JSON lines, oldest first.")] = False,
    as_json: AsJson = False,
) -> None:
    """List the audit log of all that you own, latest first: who did what, when. Admins see everything."""
    if jsonl and (as_json or limit is not None):
        reason = "--export prints everything as JSON lines; it cannot be combined with --json or --limit"
        raise InvalidInput(what="The command", reason=reason)
    fields: dict[str, object] = {
        "person_id" if person is not None and is_id(person) else "person": person,
        "token_id" if token is not None and is_id(token) else "token": token,
        "resource_type": resource_type,
        "resource_id": resource_id,
        "operation": operation,
        "since": parse_time(since),
        "until": parse_time(until),
        "as_admin": as_admin,
        **ids_of(client, project, mission),
    }
    matching = filter_of(AuditFilter, fields)
    if jsonl:
        for event in client.audit.export(matching):
            line(json.dumps(plain(event)))
        return
    headers = ["at", "who", "with", "from", "did", "to", "name", "request"]
    as_table(client.audit.list(matching, limit=limit or _AUDIT_ROWS), headers, _audit_cells).show(as_json)


def _audit_cells(row: AuditRead) -> tuple[object, ...]:
    who = row.actor.name if row.actor else None
    who = f"{who} (as admin)" if row.as_admin else who
    credential = "browser" if row.session_id is not None else None
    if row.token is not None:
        credential = f"token {row.token.name}"
    elif row.share is not None:
        credential = f"link {row.share.name}"
    return row.at, who, credential, row.address, row.operation, row.resource_type, row.resource_name, row.request_id
