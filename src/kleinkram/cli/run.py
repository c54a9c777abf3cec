"""`klein action run` and `klein run …`: launch, follow and list runs, and get their results."""

import enum
import sys
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from kleinkram.cli import options, run_reports
from kleinkram.cli.action_library import read_action
from kleinkram.cli.commands import AsJson, Many, Subcommands, Text, argument, flag, option
from kleinkram.cli.errors import ExitCode, exit_code_of
from kleinkram.cli.filters import Choice, WhereOption, filter_of, find_missions, ids_of, mission_query
from kleinkram.cli.render import Output, as_list, as_table, as_total, note, show_json
from kleinkram.cli.run_reports import split_version
from kleinkram.cli.run_view import action_name, follow, mission_name, show_results, show_run, show_runs, write_log
from kleinkram.cli.transfer import run_transfer, transfer_output
from kleinkram.cli.units import count as count_of
from kleinkram.cli.units import size
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.contract import runs as contract
from kleinkram.contract.checks import CheckStatus, Verdict
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.library import LIBRARY_PREFIX
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.problems import first_message, from_problem
from kleinkram.contract.reports import Report

ForceOption = Annotated[bool, flag("--force", "Run again, even if an identical run has results.")]
PriorityOption = Annotated[
    contract.RunPriority,
    option("--priority", None, "Start before or after other queued runs; high requires DELETE on the missions."),
]
IgnoreVerdictOption = Annotated[
    bool, flag("--ignore-verdict", "With --follow, exit with 0 also if a run is done and its verdict is bad.")
]
FollowOption = Annotated[bool, flag("--follow -f", "Show the log until the run ends, then the results.")]
_MAX_NAMES = 10
_SHOWN = 50


def launch(
    client: Client,
    action: Annotated[
        str,
        argument("ACTION", "Name, NAME@VERSION or id; or a script, a folder with action.yaml, or a shipped action."),
    ],
    missions: options.MissionsOption = None,
    project: options.ProjectsOption = None,
    query: Annotated[Text, option("--query -q", "QUERY", "Run on each mission that the query finds.")] = None,
    where: WhereOption = None,
    parameters: options.SetOption = None,
    priority: PriorityOption = contract.RunPriority.normal,
    force: ForceOption = False,
    follow_it: FollowOption = False,
    ignore_verdict: IgnoreVerdictOption = False,
    dry_run: options.DryRun = False,
    yes: options.Yes = False,
    as_json: AsJson = False,
) -> None:
    """Run an action on one mission, on several, or on each that a search finds.

    With --follow, the exit code is 0 only if all runs succeed, and 15 if one of them says that its mission is bad.
    Ctrl-C stops following; the runs continue.
    """
    targets = _missions(client, missions or [], Choice(query=query, project=project, where=where))
    path = Path(action)
    published, version = None, None
    if path.exists() or action.startswith(LIBRARY_PREFIX):
        definition = read_action(path)
        note(f"Running {definition.name} as it is in {path}, unpublished.")
    elif "/" in action or path.suffix == ".py":
        raise InvalidInput(what=f"The action {action!r}", reason="there is no such file or folder")
    else:
        name, version = split_version(action)
        projects = {mission.project.id for mission in targets}
        published = client.actions.get(name, project=projects.pop() if len(projects) == 1 else None)
        definition = client.actions.version(published, version).definition
    values = options.parameter_values(definition, parameters or [])
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
        priority=priority,
        force=force,
    )
    verdict = Counted.state_alone if ignore_verdict else Counted.verdict
    _show_launched(client, targets, outcomes, counted=verdict if follow_it else None, as_json=as_json)


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
    counted: "Counted | None",
    as_json: bool,
) -> None:
    """Show the outcomes; with `counted`, follow the runs, and exit by what counts of them."""
    made = [outcome.run for outcome in outcomes if isinstance(outcome, contract.RunCreated)]
    names = {mission.id: f"{mission.project.name}/{mission.name}" for mission in missions}
    failures = []
    for outcome in outcomes:
        if isinstance(outcome, contract.RunRefused):
            failures.append(from_problem(outcome.problem))
            note(f"{names[outcome.mission_id]}: {failures[-1]}")
    if counted is not None:
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
    if code := exit_code_of(failures) or (0 if counted is None else _exit_code(made, counted)):
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
        _show_reported(client, ended[0])
    if len(ended) == 1 and ended[0].artifact_count:
        note(f"`klein run artifacts {ended[0].id} --download DIR` downloads its artifacts.")
    return ended


def _show_reported(client: Client, run: contract.RunDetail) -> None:
    """Show what a run reported; of checks those that failed."""
    failed = {CheckStatus.error, CheckStatus.warning, CheckStatus.not_made}
    checks = client.runs.checks(contract.CheckFilter(run_id=run.id, status=[*failed])) if run.check_counts else []
    metrics = client.runs.metrics(contract.MetricFilter(run_id=run.id))
    findings = client.runs.findings(contract.FindingFilter(run_id=run.id))
    show_results([row.check for row in checks], [row.metric for row in metrics], [row.finding for row in findings])


class Counted(enum.Enum):
    """What counts for the exit code of runs that were followed: their states alone, or their verdicts too."""

    state_alone = enum.auto()
    verdict = enum.auto()


def _exit_code(runs: Sequence[contract.RunRead], counted: Counted) -> int:
    if any(run.state is not contract.RunState.done for run in runs):
        return ExitCode.run_failed
    is_bad = counted is Counted.verdict and any(run.verdict is Verdict.bad for run in runs)
    return ExitCode.verdict_bad if is_bad else 0


app = Subcommands("Manage runs of actions on missions.")
RunArgument = Annotated[str, argument("RUN", "Id of the run.")]


@app.command("list")
def list_(
    client: Client,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    action: Annotated[Text, option("--action", "GLOB", "Select runs of actions with a matching name.")] = None,
    state: Annotated[list[contract.RunState] | None, option("--state", None, "Select by state; repeatable.")] = None,
    verdict: Annotated[
        list[Verdict] | None, option("--verdict", None, "Select by verdict: good, warnings or bad; repeatable.")
    ] = None,
    node: Annotated[Text, option("--node", "NODE", "Select runs on a node of a cluster.")] = None,
    job: Annotated[Text, option("--job", "ID", "Select the run of a job of a cluster.")] = None,
    isolation: Annotated[
        list[Isolation] | None, option("--isolation", None, "Select by the isolation that runs had; repeatable.")
    ] = None,
    active: Annotated[bool, flag("--active", "Select only runs that have not ended.")] = False,
    mine: Annotated[bool, flag("--mine", "Select only your own runs.")] = False,
    limit: options.Limit = None,
    count: options.Count = False,
) -> Output:
    """List runs, latest first."""
    criteria: dict[str, object] = {"action": action, "state": state, "active": active, "mine": mine}
    criteria |= {"verdict": verdict, "node": node, "job_id": job, "isolation": isolation}
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
    ignore_verdict: IgnoreVerdictOption = False,
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
        raise typer.Exit(_exit_code([selected], Counted.state_alone if ignore_verdict else Counted.verdict))


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
    ignore_verdict: IgnoreVerdictOption = False,
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
        raise typer.Exit(_exit_code([made], Counted.state_alone if ignore_verdict else Counted.verdict))


@app.command("record")
def record(
    client: Client,
    name: Annotated[str, argument("NAME", "What was executed, as for an action: a name.")],
    script: Annotated[Path, option("--script", "FILE", "The script that was executed; its text is kept.")],
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    inputs: Annotated[Many, option("--input", "PATH", "A file of the mission that it read; repeatable.")] = None,
    outputs: Annotated[
        Many, option("--output", "PATH", "A file of the mission that it made, uploaded before; repeatable.")
    ] = None,
    parameters: options.SetOption = None,
    report: Annotated[
        Path | None, option("--report", "FILE", "Its report.json: metrics, findings, checks, metadata.")
    ] = None,
    duration_s: Annotated[float | None, option("--duration", "SECONDS", "How long it took.", min=0)] = None,
) -> Output:
    """Record a run that was executed elsewhere, such as by a pipeline, with its results and their lineage.

    The same command again changes nothing.
    """
    target = client.missions.get(options.the_ref("mission", None, mission), project=project)
    reported = None
    if (text := options.read_text(report)) is not None:
        try:
            reported = Report.model_validate_json(text)
        except ValidationError as error:
            raise InvalidInput(what=f"The report {report}", reason=first_message(error)) from None
    recorded = client.runs.record(
        name,
        target,
        script=options.read_text(script) or "",
        inputs=inputs or [],
        outputs=outputs or [],
        parameters=options.untyped_values(parameters or []),
        report=reported,
        duration_s=duration_s,
    )
    return as_list([recorded], show_runs)


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


app.command("checks")(run_reports.checks)
app.command("findings")(run_reports.findings)
app.command("metrics")(run_reports.metrics)
