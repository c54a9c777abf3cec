"""`klein action run`"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.errors import ExitCode, exit_code_of
from kleinkram.cli.filters import Choice, Many, find_missions, mission_query
from kleinkram.cli.following import follow, heading, last_word
from kleinkram.cli.options import AsJson, DryRun, MissionsOption, ProjectsOption, Yes, confirm
from kleinkram.cli.render import note, show_json
from kleinkram.cli.run_view import mission_name, show_results, show_runs
from kleinkram.cli.units import count
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.manifest import read_manifest
from kleinkram.contract.actions import ActionDefinition, ActionRead, ParameterValues
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.problems import from_problem
from kleinkram.contract.runs import ReportFilter, RunCreated, RunDetail, RunRead, RunRefused, RunState

SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A parameter; may be given several times.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Run anew, though there are results of the very same.")]
FollowOption = Annotated[bool, typer.Option("--follow", "-f", help="Show its log until it is over, then its results.")]

_NAMED = 10


@dataclass(frozen=True)
class _Wanted:
    """What to run: a published action in a version, or a definition that nobody has published."""

    definition: ActionDefinition
    action: ActionRead | None = None
    version: int | None = None


def run(
    action: Annotated[
        str,
        typer.Argument(metavar="ACTION", help="Name, NAME@VERSION or id; or a script, or a folder with action.yaml."),
    ],
    missions: MissionsOption = None,
    project: ProjectsOption = None,
    query: Annotated[
        str | None, typer.Option("--query", "-q", metavar="QUERY", help="On each mission that a search finds.")
    ] = None,
    where: Annotated[
        Many, typer.Option("--where", "-w", metavar="FIELD=VALUE", help="By metadata: robot=anymal.")
    ] = None,
    parameters: SetOption = None,
    force: ForceOption = False,
    follow_it: FollowOption = False,
    dry_run: DryRun = False,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Run an action on a mission, on several, or on each that a search finds.

    With --follow the exit code is 0 only if all went well; Ctrl-C ends the following, not the run.
    """
    with connect() as client:
        found = _missions(client, missions or [], Choice(query=query, project=project, where=where))
        wanted = _wanted(client, action, found)
        values = parameter_values(wanted.definition, parameters or [])
        names = _listing(found)
        if dry_run:
            note(f"Would run {action} on {names}")
            if as_json:
                show_json({"dry_run": True, "missions": found, "parameters": values})
            return
        if not missions and len(found) > 1:
            confirm(f"Run {action} on {count(len(found), 'mission')}: {names}?", yes)
        outcomes = client.runs.launch(
            wanted.action.id if wanted.action else wanted.definition,
            [each.id for each in found],
            version=wanted.version,
            parameters=values,
            force=force,
        )
        _show(client, found, outcomes, follow_it=follow_it, as_json=as_json)


def parameter_values(definition: ActionDefinition, said: Iterable[str]) -> ParameterValues:
    """Return the values that `NAME=VALUE`s mean for the parameters of an action, checked.

    Raises:
        InvalidInput: one is not said so, is unknown, missing, or not what it should be.
    """
    known = {parameter.name: parameter for parameter in definition.parameters}
    values: ParameterValues = {}
    for each in said:
        name, equals, text = each.partition("=")
        if not equals:
            raise InvalidInput(what=f"The parameter {each!r}", reason="say it as NAME=VALUE")
        try:
            values[name] = known[name].read(text) if name in known else text
        except ValueError as error:
            raise InvalidInput(what="The parameters", reason=str(error)) from None
    try:
        definition.fill_in(values)
    except ValueError as error:
        raise InvalidInput(what="The parameters", reason=str(error)) from None
    return values


def split_version(ref: str) -> tuple[str, int | None]:
    """Return the name and the number of `NAME@NUMBER`; any other reference is itself, without a number."""
    name, _, number = ref.rpartition("@")
    return (name, int(number)) if name and number.isdecimal() and number.isascii() else (ref, None)


def follow_all(client: Client, runs: Sequence[RunRead], *, as_json: bool) -> list[RunDetail]:
    """Show runs until they are over, one after the other, then what came of them."""
    ended: list[RunDetail] = []
    for each in runs:
        if len(runs) > 1:
            note(heading(each))
        over = follow(client, each.id)
        last_word(over)
        ended.append(over)
    if not as_json:
        show_runs(ended)
    if len(ended) == 1 and not as_json:
        matching = ReportFilter(run_id=ended[0].id)
        show_results([*client.runs.metrics(matching)], [*client.runs.findings(matching)])
    if len(ended) == 1 and ended[0].artifact_count:
        note(f"`klein run artifacts {ended[0].id} --download DIR` fetches what it left.")
    return ended


def code_of(runs: Iterable[RunRead]) -> int:
    """Return the exit code for runs that are over: 0 only where all went well."""
    return 0 if all(each.state is RunState.done for each in runs) else ExitCode.run_failed


def _missions(client: Client, names: Sequence[str], choice: Choice) -> list[MissionRead]:
    searched = choice.query is not None or bool(choice.where)
    if bool(names) == searched:
        raise InvalidInput(
            what="The command", reason="say which missions: with -m, or by a search with --query or --where"
        )
    if names:
        found = [mission for each in names for mission in find_missions(client, each, choice.project)]
        return [*{mission.id: mission for mission in found}.values()]
    found = [*client.missions.list(query=mission_query(client, choice))]
    if not found:
        raise NothingToDo(reason="No mission matches")
    return found


def _listing(missions: Sequence[MissionRead]) -> str:
    shown = ", ".join(f"{each.project.name}/{each.name}" for each in missions[:_NAMED])
    return shown if len(missions) <= _NAMED else f"{shown} and {len(missions) - _NAMED} more"


def _wanted(client: Client, ref: str, missions: Sequence[MissionRead]) -> _Wanted:
    path = Path(ref)
    if path.exists():
        definition = read_manifest(path)
        note(f"Running {definition.name} as it is in {path}, unpublished.")
        return _Wanted(definition)
    if "/" in ref or path.suffix == ".py":
        raise InvalidInput(what=f"The action {ref!r}", reason="there is no such file or folder")
    name, version = split_version(ref)
    projects = {mission.project.id for mission in missions}
    action = client.actions.get(name, project=projects.pop() if len(projects) == 1 else None)
    return _Wanted(client.actions.version(action, version).definition, action, version)


def _show(
    client: Client,
    missions: Sequence[MissionRead],
    outcomes: Sequence[RunCreated | RunRefused],
    *,
    follow_it: bool,
    as_json: bool,
) -> None:
    made = [each.run for each in outcomes if isinstance(each, RunCreated)]
    refused = [each for each in outcomes if isinstance(each, RunRefused)]
    names = {each.id: f"{each.project.name}/{each.name}" for each in missions}
    failures = [from_problem(each.problem) for each in refused]
    for each, failure in zip(refused, failures, strict=True):
        note(f"{names[each.mission_id]}: {failure}")
    if follow_it:
        made = [*follow_all(client, made, as_json=as_json)]
    elif made:
        _say_made(made, as_json=as_json)
    if as_json:
        now = {each.id: each for each in made}
        items = [RunCreated(run=now[each.run.id]) if isinstance(each, RunCreated) else each for each in outcomes]
        show_json({"items": items})
    code = exit_code_of(failures) or (code_of(made) if follow_it else 0)
    if code:
        raise typer.Exit(code)


def _say_made(made: Sequence[RunRead], *, as_json: bool) -> None:
    if not as_json:
        show_runs(made)
    over = [each for each in made if each.reuses_id is not None]
    for each in over:
        note(f"{mission_name(each)}: results of the run {each.reuses_id} hold; --force runs anew.")
    if len(made) == 1 and not over:
        note(f"`klein run logs -f {made[0].id}` follows it.")
