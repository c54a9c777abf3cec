"""`klein run …`"""

import sys
import time
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.errors import Interrupted, exit_code_of
from kleinkram.cli.filters import Many, ids_of
from kleinkram.cli.following import follow, last_word
from kleinkram.cli.launch import FollowOption, ForceOption, code_of, follow_all
from kleinkram.cli.log_view import write_log
from kleinkram.cli.options import AsJson, Limit, MissionsOption, ProjectsOption
from kleinkram.cli.render import line, note, show_json, show_json_list, table
from kleinkram.cli.run_view import action_name, show_run, show_runs
from kleinkram.cli.transfer_view import plain_report, say_left_out, say_summary
from kleinkram.cli.units import instant, size
from kleinkram.client import Client
from kleinkram.client._nouns import checked
from kleinkram.client.errors import NothingToDo
from kleinkram.contract.reports import Severity
from kleinkram.contract.runs import ReportFilter, RunFilter, RunState

_SHOWN = 50

app = Noun("Runs: executions of actions on missions.")

RunArgument = Annotated[str, typer.Argument(metavar="RUN", help="Its id.", show_default=False)]
CodeOption = Annotated[str | None, typer.Option("--name", metavar="GLOB", help="Of this name, such as 'imu.*'.")]


@app.command("list")
def list_(
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    action: Annotated[str | None, typer.Option("--action", metavar="GLOB", help="Of actions of this name.")] = None,
    state: Annotated[list[RunState] | None, typer.Option("--state", help="May be given several times.")] = None,
    active: Annotated[bool, typer.Option("--active", help="Only those that are not over.")] = False,
    mine: Annotated[bool, typer.Option("--mine", help="Only those that you made.")] = False,
    limit: Limit = None,
    count: Annotated[bool, typer.Option("--count", help="Only say how many.")] = False,
    as_json: AsJson = False,
) -> None:
    """List runs, latest first."""
    given: dict[str, object] = {"action": action, "state": state, "active": active, "mine": mine}
    with connect() as client:
        given |= ids_of(client, project, mission)
        matching = checked(RunFilter, "The filter", **{key: value for key, value in given.items() if value})
        if count:
            number = client.runs.count(matching)
            show_json({"total": number}) if as_json else line(str(number))
            return
        rows = [*client.runs.list(matching, limit=limit or _SHOWN)]
    show_json_list(rows) if as_json else show_runs(rows)
    if limit is None and len(rows) == _SHOWN:
        note(f"These are the latest {_SHOWN}; --limit shows more.")


@app.command("info")
def info(run: RunArgument, as_json: AsJson = False) -> None:
    """Show a run: how it ended and why, what it used, and what it proposes for its mission."""
    with connect() as client:
        found = client.runs.get(run)
    show_json(found) if as_json else show_run(found)


@app.command("logs")
def logs(
    run: RunArgument,
    follow_it: Annotated[bool, typer.Option("--follow", "-f", help="Until it is over; then as it ended.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print what a run has written."""
    with connect() as client:
        found = client.runs.get(run)
        if follow_it and not as_json:
            over = follow(client, found.id)
            last_word(over)
            raise typer.Exit(code_of([over]))
        if as_json:
            text = "".join(each.text for each in client.runs.log(found.id, follow=follow_it))
            found = client.runs.wait(found.id) if follow_it else found
            show_json({"run_id": str(found.id), "state": found.state.value, "text": text})
            raise typer.Exit(code_of([found]) if follow_it else 0)
        for piece in client.runs.log(found.id):
            write_log(piece.text, sys.stdout)


@app.command("cancel")
def cancel(
    runs: Annotated[list[str], typer.Argument(metavar="RUN", help="Ids.", show_default=False)],
    as_json: AsJson = False,
) -> None:
    """End runs: those that wait at once, those that go on within seconds."""
    with connect() as client:
        found = [client.runs.get(each) for each in runs]
        ended = [client.runs.cancel(each.id) for each in found]
    show_json_list(ended) if as_json else show_runs(ended)


@app.command("retry")
def retry(
    run: RunArgument, force: ForceOption = False, follow_it: FollowOption = False, as_json: AsJson = False
) -> None:
    """Run the same version again, with the same parameters on the same mission: a new run."""
    with connect() as client:
        made = client.runs.retry(client.runs.get(run).id, force=force)
        if follow_it:
            (made,) = follow_all(client, [made], as_json=as_json)
    if as_json:
        show_json(made)
    elif not follow_it:
        show_runs([made])
    if follow_it:
        raise typer.Exit(code_of([made]))


@app.command("artifacts")
def artifacts(
    run: RunArgument,
    paths: Annotated[Many, typer.Argument(metavar="GLOB", help="Only these.", show_default=False)] = None,
    download: Annotated[
        Path | None, typer.Option("--download", metavar="DIR", help="Fetch them into a folder, verified.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that differ.")] = False,
    as_json: AsJson = False,
) -> None:
    """List the files that a run left, or fetch them."""
    with connect() as client:
        found = client.runs.get(run)
        rows = [
            row
            for row in client.runs.artifacts(found.id)
            if not paths or any(fnmatchcase(row.path, glob) for glob in paths)
        ]
        if download is None:
            cells = [(row.path, size(row.size_bytes), row.sha256, row.file_id) for row in rows]
            show_json_list(rows) if as_json else table(["path", "size", "sha256", "file of the mission"], cells)
            return
        if not rows:
            raise NothingToDo(reason="No artifact matches")
        from kleinkram.cli.transfer_view import watching

        began_at = time.monotonic()
        try:
            with watching() as watcher:
                report = client.runs.download_artifacts(
                    found.id, download, artifacts=rows, overwrite=overwrite, watcher=watcher
                )
        except KeyboardInterrupt:
            raise Interrupted from None
    elapsed_s = time.monotonic() - began_at
    if as_json:
        show_json({"elapsed_s": elapsed_s, **plain_report(report)})
    say_left_out(report.left_out)
    say_summary(report, elapsed_s)
    if code := exit_code_of([*report.failures, *report.left_out]):
        raise typer.Exit(code)


@app.command("findings")
def findings(
    run: Annotated[str | None, typer.Argument(metavar="RUN", help="Of one run.", show_default=False)] = None,
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    name: CodeOption = None,
    severity: Annotated[list[Severity] | None, typer.Option("--severity", help="May be given several times.")] = None,
    limit: Limit = None,
    as_json: AsJson = False,
) -> None:
    """List what runs have noticed: of one, of a mission, of a project, or of all."""
    with connect() as client:
        matching = _saying(client, run, project, mission, code=name, severity=severity)
        rows = [*client.runs.findings(matching, limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["mission", "action", "severity", "finding", "message", "file", "topic", "at", "run"],
        [
            (
                row.mission.name,
                action_name(row.action),
                row.finding.severity.value,
                row.finding.code,
                row.finding.message,
                row.finding.file,
                row.finding.topic,
                instant(row.finding.time_ns),
                row.run_id,
            )
            for row in rows
        ],
    )


@app.command("metrics")
def metrics(
    run: Annotated[str | None, typer.Argument(metavar="RUN", help="Of one run.", show_default=False)] = None,
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    name: CodeOption = None,
    limit: Limit = None,
    as_json: AsJson = False,
) -> None:
    """List the numbers that runs have found: of one, of a mission, of a project, or of all."""
    with connect() as client:
        rows = [*client.runs.metrics(_saying(client, run, project, mission, code=name), limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["mission", "action", "metric", "value", "unit", "file", "run"],
        [
            (
                row.mission.name,
                action_name(row.action),
                row.metric.name,
                row.metric.value,
                row.metric.unit,
                row.metric.file,
                row.run_id,
            )
            for row in rows
        ],
    )


def _saying(client: Client, run: str | None, project: Many, mission: Many, **more: object) -> ReportFilter:
    given: dict[str, object] = {**more, **ids_of(client, project, mission)}
    if run is not None:
        given["run_id"] = client.runs.get(run).id
    return checked(ReportFilter, "The filter", **{key: value for key, value in given.items() if value})
