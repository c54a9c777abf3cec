"""`klein action run` and `klein run …`: launch, follow and list runs, and get their results."""

import sys
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli import options
from kleinkram.cli.commands import AsJson, Many, Subcommands, Text, argument, flag, option
from kleinkram.cli.errors import ExitCode, exit_code_of
from kleinkram.cli.filters import Choice, WhereOption, filter_of, find_missions, ids_of, mission_query
from kleinkram.cli.render import Output, as_list, as_table, as_total, note, show_json
from kleinkram.cli.run_view import action_name, follow, mission_name, show_results, show_run, show_runs, write_log
from kleinkram.cli.transfer import run_transfer, transfer_output
from kleinkram.cli.units import count as count_of
from kleinkram.cli.units import instant, size
from kleinkram.client import Client
from kleinkram.client.actions import read_manifest
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.contract import runs as contract
from kleinkram.contract.actions import ActionDefinition, ParameterValues
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.problems import from_problem
from kleinkram.contract.reports import Severity

SetOption = Annotated[Many, option("--set", "NAME=VALUE", "Set a parameter; repeatable.")]
ForceOption = Annotated[bool, flag("--force", "Run again, even if an identical run has results.")]
FollowOption = Annotated[bool, flag("--follow -f", "Show the log until the run ends, then the results.")]
_MAX_NAMES = 10
_SHOWN = 50


def launch(
    client: Client,
    action: Annotated[str, argument("ACTION", "Name, NAME@VERSION or id; or a script, or a folder with action.yaml.")],
    missions: options.MissionsOption = None,
    project: options.ProjectsOption = None,
    query: Annotated[Text, option("--query -q", "QUERY", "Run on each mission that the query finds.")] = None,
    where: WhereOption = None,
    parameters: SetOption = None,
    force: ForceOption = False,
    follow_it: FollowOption = False,
    dry_run: options.DryRun = False,
    yes: options.Yes = False,
    as_json: AsJson = False,
) -> None:
    """Run an action on one mission, on several, or on each that a search finds.

    With --follow, the exit code is 0 only if all runs succeed. Ctrl-C stops following; the runs continue.
    """
    targets = _missions(client, missions or [], Choice(query=query, project=project, where=where))
    path = Path(action)
    published, version = None, None
    if path.exists():
        definition = read_manifest(path)
        note(f"Running {definition.name} as it is in {path}, unpublished.")
    elif "/" in action or path.suffix == ".py":
        raise InvalidInput(what=f"The action {action!r}", reason="there is no such file or folder")
    else:
        name, version = split_version(action)
        projects = {mission.project.id for mission in targets}
        published = client.actions.get(name, project=projects.pop() if len(projects) == 1 else None)
        definition = client.actions.version(published, version).definition
    values = parameter_values(definition, parameters or [])
    names = ", ".join(f"{mission.project.name}/{mission.name}" for mission in targets[:_MAX_NAMES])
    names += f" and {len(targets) - _MAX_NAMES} more" if len(targets) > _MAX_NAMES else ""
    if dry_run:
        note(f"Would run {action} on {names}")
        if as_json:
            show_json({"dry_run": True, "missions": targets, "parameters": values})
        return
    if not missions and len(targets) > 1:
        options.confirm(f"Run {action} on {count_of(len(targets), 'mission')}: {names}?", yes)
    outcomes = client.runs.launch(
        published.id if published else definition,
        [mission.id for mission in targets],
        version=version,
        parameters=values,
        force=force,
    )
    _show_launched(client, targets, outcomes, follow_them=follow_it, as_json=as_json)


def parameter_values(definition: ActionDefinition, assignments: Iterable[str]) -> ParameterValues:
    """Return the checked values that `NAME=VALUE` assignments set for the parameters of an action."""
    known = {parameter.name: parameter for parameter in definition.parameters}
    values: ParameterValues = {}
    try:
        for assignment in assignments:
            name, equals, text = assignment.partition("=")
            if not equals:
                raise InvalidInput(what=f"The parameter {assignment!r}", reason="write it as NAME=VALUE")
            values[name] = known[name].read(text) if name in known else text
        definition.fill_in(values)
    except ValueError as error:
        raise InvalidInput(what="The parameters", reason=str(error)) from None
    return values


def split_version(ref: str) -> tuple[str, int | None]:
    """Return the name and the number of `NAME@NUMBER`; any other reference is itself, without a number."""
    name, _, number = ref.rpartition("@")
    return (name, int(number)) if name and number.isdecimal() and number.isascii() else (ref, None)


def _missions(client: Client, names: Sequence[str], choice: Choice) -> list[MissionRead]:
    if bool(names) == (choice.query is not None or bool(choice.where)):
        reason = "specify missions with -m, or with a search: --query or --where"
        raise InvalidInput(what="The command", reason=reason)
    if names:
        targets = [mission for name in names for mission in find_missions(client, name, choice.project)]
        return [*{mission.id: mission for mission in targets}.values()]
    targets = [*client.missions.list(query=mission_query(client, choice))]
    if not targets:
        raise NothingToDo(reason="No mission matches")
    return targets


def _show_launched(
    client: Client,
    missions: Sequence[MissionRead],
    outcomes: Sequence[contract.RunCreated | contract.RunRefused],
    *,
    follow_them: bool,
    as_json: bool,
) -> None:
    made = [outcome.run for outcome in outcomes if isinstance(outcome, contract.RunCreated)]
    names = {mission.id: f"{mission.project.name}/{mission.name}" for mission in missions}
    failures = []
    for outcome in outcomes:
        if isinstance(outcome, contract.RunRefused):
            failures.append(from_problem(outcome.problem))
            note(f"{names[outcome.mission_id]}: {failures[-1]}")
    if follow_them:
        made = [*_follow_all(client, made, as_json=as_json)]
    elif made:
        if not as_json:
            show_runs(made)
        reused = [run for run in made if run.reuses_id is not None]
        for run in reused:
            note(f"{mission_name(run)}: the results of run {run.reuses_id} apply; --force runs it again.")
        if len(made) == 1 and not reused:
            note(f"`klein run logs -f {made[0].id}` follows it.")
    if as_json:
        now = {run.id: run for run in made}
        items = [
            contract.RunCreated(run=now[item.run.id]) if isinstance(item, contract.RunCreated) else item
            for item in outcomes
        ]
        show_json({"items": items})
    if code := exit_code_of(failures) or (_exit_code(made) if follow_them else 0):
        raise typer.Exit(code)


def _follow_all(client: Client, runs: Sequence[contract.RunRead], *, as_json: bool) -> list[contract.RunDetail]:
    """Show runs until they end, one after the other, then their results."""
    ended: list[contract.RunDetail] = []
    for run in runs:
        if len(runs) > 1:
            note(f"— {mission_name(run)}: {action_name(run.action)}, run {run.id}")
        ended.append(follow(client, run.id))
    if not as_json:
        show_runs(ended)
    if len(ended) == 1 and not as_json:
        matching = contract.ReportFilter(run_id=ended[0].id)
        show_results([*client.runs.metrics(matching)], [*client.runs.findings(matching)])
    if len(ended) == 1 and ended[0].artifact_count:
        note(f"`klein run artifacts {ended[0].id} --download DIR` downloads its artifacts.")
    return ended


def _exit_code(runs: Iterable[contract.RunRead]) -> int:
    return 0 if all(run.state is contract.RunState.done for run in runs) else ExitCode.run_failed


app = Subcommands("Manage runs of actions on missions.")
RunArgument = Annotated[str, argument("RUN", "Id of the run.")]
RunFilterArgument = Annotated[Text, argument("RUN", "Id of a run.")]
CodeOption = Annotated[Text, option("--name", "GLOB", "Select by name, such as 'imu.*'.")]


@app.command("list")
def list_(
    client: Client,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    action: Annotated[Text, option("--action", "GLOB", "Select runs of actions with a matching name.")] = None,
    state: Annotated[list[contract.RunState] | None, option("--state", None, "Select by state; repeatable.")] = None,
    active: Annotated[bool, flag("--active", "Select only runs that have not ended.")] = False,
    mine: Annotated[bool, flag("--mine", "Select only your own runs.")] = False,
    limit: options.Limit = None,
    count: options.Count = False,
) -> Output:
    """List runs, latest first."""
    criteria: dict[str, object] = {"action": action, "state": state, "active": active, "mine": mine}
    criteria |= ids_of(client, project, mission)
    matching = filter_of(contract.RunFilter, criteria)
    if count:
        return as_total(client.runs.count(matching))
    rows = [*client.runs.list(matching, limit=limit or _SHOWN)]
    if limit is None and len(rows) == _SHOWN:
        note(f"These are the latest {_SHOWN}; --limit shows more.")
    return as_list(rows, show_runs)


@app.command("info")
def info(client: Client, run: RunArgument) -> Output:
    """Show a run: its state and reason, its use of resources, and the metadata that it proposes."""
    selected = client.runs.get(run)
    return Output(selected, lambda: show_run(selected))


@app.command("logs")
def logs(
    client: Client,
    run: RunArgument,
    follow_it: Annotated[bool, flag("--follow -f", "Print until the run ends, and exit as it ended.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print the log of a run."""
    selected: contract.RunRead = client.runs.get(run)
    if as_json:
        text = "".join(entry.text for entry in client.runs.log(selected.id, follow=follow_it))
        selected = client.runs.wait(selected.id) if follow_it else selected
        show_json({"run_id": str(selected.id), "state": selected.state.value, "text": text})
    elif follow_it:
        selected = follow(client, selected.id)
    else:
        for piece in client.runs.log(selected.id):
            write_log(piece.text, sys.stdout)
    if follow_it:
        raise typer.Exit(_exit_code([selected]))


@app.command("cancel")
def cancel(client: Client, runs: Annotated[list[str], argument("RUN", "Ids of runs.")]) -> Output:
    """Cancel runs. Queued runs end at once, running ones within seconds."""
    selected = [client.runs.get(ref) for ref in runs]
    return as_list([client.runs.cancel(run.id) for run in selected], show_runs)


@app.command("retry")
def retry(
    client: Client,
    run: RunArgument,
    force: ForceOption = False,
    follow_it: FollowOption = False,
    as_json: AsJson = False,
) -> None:
    """Run the same version again, as a new run with the same parameters on the same mission."""
    made: contract.RunRead = client.runs.retry(client.runs.get(run).id, force=force)
    if follow_it:
        (made,) = _follow_all(client, [made], as_json=as_json)
    if as_json:
        show_json(made)
    elif not follow_it:
        show_runs([made])
    if follow_it:
        raise typer.Exit(_exit_code([made]))


@app.command("artifacts")
def artifacts(
    client: Client,
    run: RunArgument,
    paths: Annotated[Many, argument("GLOB", "Globs that paths match.")] = None,
    download: Annotated[Path | None, option("--download", "DIR", "Download them to DIR, verified.")] = None,
    overwrite: options.Overwrite = False,
) -> Output:
    """List or download the files that a run created."""
    run_id = client.runs.get(run).id
    globs = paths or ["*"]
    rows = [row for row in client.runs.artifacts(run_id) if any(fnmatchcase(row.path, glob) for glob in globs)]
    if download is None:
        headers = ["path", "size", "sha256", "file of the mission"]
        return as_table(rows, headers, lambda row: (row.path, size(row.size_bytes), row.sha256, row.file_id))
    if not rows:
        raise NothingToDo(reason="No artifact matches")
    report, elapsed_s = run_transfer(
        lambda watcher: client.runs.download_artifacts(
            run_id, download, artifacts=rows, overwrite=overwrite, watcher=watcher
        )
    )
    for error in report.left_out:
        note(str(error))
    return transfer_output(report, elapsed_s)


@app.command("findings")
def findings(
    client: Client,
    run: RunFilterArgument = None,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    name: CodeOption = None,
    severity: Annotated[list[Severity] | None, option("--severity", None, "Select by severity; repeatable.")] = None,
    limit: options.Limit = None,
) -> Output:
    """List the findings of one run, a mission, a project, or of all."""
    matching = _report_filter(client, run, project, mission, code=name, severity=severity)
    headers = ["mission", "action", "severity", "finding", "message", "file", "topic", "at", "run"]
    return as_table(client.runs.findings(matching, limit=limit), headers, _finding_cells)


def _finding_cells(row: contract.FindingRead) -> tuple[object, ...]:
    finding = row.finding
    what = (finding.severity.value, finding.code, finding.message, finding.file, finding.topic)
    return row.mission.name, action_name(row.action), *what, instant(finding.time_ns), row.run_id


@app.command("metrics")
def metrics(
    client: Client,
    run: RunFilterArgument = None,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    name: CodeOption = None,
    limit: options.Limit = None,
) -> Output:
    """List the metrics of one run, a mission, a project, or of all."""
    matching = _report_filter(client, run, project, mission, code=name)
    headers = ["mission", "action", "metric", "value", "unit", "file", "run"]
    return as_table(client.runs.metrics(matching, limit=limit), headers, _metric_cells)


def _metric_cells(row: contract.MetricRead) -> tuple[object, ...]:
    metric = row.metric
    what = (metric.name, metric.value, metric.unit, metric.file)
    return row.mission.name, action_name(row.action), *what, row.run_id


def _report_filter(client: Client, run: Text, project: Many, mission: Many, **more: object) -> contract.ReportFilter:
    criteria: dict[str, object] = {**more, **ids_of(client, project, mission)}
    if run is not None:
        criteria["run_id"] = client.runs.get(run).id
    return filter_of(contract.ReportFilter, criteria)
