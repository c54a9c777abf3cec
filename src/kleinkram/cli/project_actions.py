"""`klein project actions …`: the actions that run by themselves on the missions of a project."""

from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import Subcommands, Text, argument, option
from kleinkram.cli.render import Output, as_table
from kleinkram.cli.run_view import action_name, labels_text
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.project_actions import ProjectActionRead, RunTrigger
from kleinkram.contract.units import read_duration

app = Subcommands("Manage the actions that run by themselves on the missions of a project, and count for its verdicts.")
ActionArgument = Annotated[str, argument("ACTION", "Name or id of a published action.")]
_NS = 10**9


@app.command("add")
def add(
    client: Client,
    action: ActionArgument,
    project: options.ProjectOption = None,
    on: Annotated[
        RunTrigger, option("--on", None, "Run once a mission is marked complete, or once its files are idle.")
    ] = RunTrigger.complete,
    idle: Annotated[
        Text, option("--idle", "TIME", "With --on idle: without a change for TIME (10m if not set).")
    ] = None,
    parameters: options.SetOption = None,
) -> Output:
    """Have an action run by itself, once on the same files with the same version. Its runs act for you."""
    target = client.projects.get(_required(project))
    published = client.actions.get(action, project=target.id)
    values = options.parameter_values(client.actions.version(published, None).definition, parameters or [])
    if idle is not None and on is not RunTrigger.idle:
        raise InvalidInput(what="The command", reason="--idle requires --on idle")
    idle_s = None if idle is None else _seconds(idle)
    added = client.project_actions.add(target.id, published.id, on=on, idle_s=idle_s, parameters=values)
    return Output(added, f"{action_name(added.action)} runs by itself in {target.name}: {_when(added)}.")


@app.command("list")
def list_(client: Client, project: options.ProjectOption = None) -> Output:
    """List the actions that run by themselves, and why they last did not."""
    return as_table(
        client.project_actions.list(_required(project)),
        ["action", "runs", "parameters", "added by", "added", "missions with problems", "problem"],
        lambda row: (
            *(action_name(row.action), _when(row), labels_text(row.parameters)),
            *(row.added_by.name, row.added_at, row.problem_count, row.problem),
        ),
    )


@app.command("remove")
def remove(client: Client, action: ActionArgument, project: options.ProjectOption = None) -> Output:
    """Stop an action from running by itself, and its results from counting. Its runs stay."""
    target = client.projects.get(_required(project))
    listed = client.project_actions.list(target.id)
    named = next((row for row in listed if action in {row.action.name, str(row.action.id)}), None)
    if named is None or named.action.id is None:
        raise InvalidInput(what=f"The action {action!r}", reason=f"{target.name} does not name it")
    client.project_actions.remove(target.id, named.action.id)
    return Output({"removed": named.action.name}, f"{named.action.name} no longer runs by itself in {target.name}.")


def _required(project: Text) -> str:
    if project is None:
        raise InvalidInput(what="The command", reason="specify a project with -p")
    return project


def _seconds(text: str) -> int:
    what = f"The time {text!r}"
    try:
        seconds = read_duration(text) // _NS
    except ValueError as error:
        raise InvalidInput(what=what, reason=str(error)) from None
    if seconds < 1:
        raise InvalidInput(what=what, reason="it must be at least 1 s")
    return seconds


def _when(row: ProjectActionRead) -> str:
    if row.on is RunTrigger.complete:
        return "when a mission is marked complete"
    return f"when the files of a mission have not changed for {row.idle_s} s"
