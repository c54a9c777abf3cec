"""`klein action …`"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kleinkram import connect
from kleinkram.cli.action_view import show_action, show_actions, show_versions
from kleinkram.cli.building import build
from kleinkram.cli.commands import Noun
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.launch import SetOption, parameter_values, run, split_version
from kleinkram.cli.log_view import on_stderr
from kleinkram.cli.options import AsJson, IfMatch, Limit, MissionOption, ProjectOption, ProjectsOption
from kleinkram.cli.render import line, note, show_json, show_json_list
from kleinkram.cli.run_view import show_findings, show_metrics
from kleinkram.cli.scaffold import init
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.client.manifest import read_manifest
from kleinkram.contract.actions import ActionDefinition, ActionRead
from kleinkram.contract.runners import Isolation
from kleinkram.contract.runs import EndReason

if TYPE_CHECKING:
    from kleinkram.runner.executors.base import Executor
    from kleinkram.runner.local_run import LocalRun

_ISOLATIONS = {
    Isolation.container: "in a container.",
    Isolation.namespaces: "as a process, in namespaces of its own.",
    Isolation.none: "as a plain process: this kernel gives no namespaces to you, so it can change whatever you can.",
}

app = Noun("Actions: what to run on the files of a mission.")
app.command("init")(init)
app.command("run")(run)

PathArgument = Annotated[
    Path, typer.Argument(metavar="PATH", help="A script, or a folder with action.yaml.", show_default=False)
]
ActionArgument = Annotated[str, typer.Argument(metavar="ACTION", help="Name or id.", show_default=False)]


@app.command("run-local")
def run_local(
    action: PathArgument,
    mission: MissionOption = None,
    project: ProjectOption = None,
    parameters: SetOption = None,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where results go; empty or not there yet.")] = Path(
        "out"
    ),
    no_build: Annotated[
        bool, typer.Option("--no-build", help="Take the image as it is, though there is a Dockerfile.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run an action on this machine, on a mission: the same /in and /out as on a runner. Nothing is stored.

    An action with an image runs in a container, built first of the Dockerfile beside its manifest; any other runs as a
    process.
    """
    from kleinkram.cli.transfer_view import watching
    from kleinkram.runner.local_run import run_locally

    definition = read_manifest(action)
    values = parameter_values(definition, parameters or [])
    if mission is None:
        raise InvalidInput(what="The command", reason="say which mission, with -m")
    executor = _executor(definition)
    if definition.image is not None:
        if not no_build:
            build(action if action.is_dir() else action.parent, definition.image)
        definition = _pinned(executor, definition, definition.image)
    with connect() as client, watching() as watcher:
        target = client.missions.get(mission, project=project)
        ran = run_locally(
            client, definition, target, values, executor=executor, out=out, show=on_stderr, watcher=watcher
        )
    _show_local(ran, as_json)


def _executor(definition: ActionDefinition) -> "Executor":
    from kleinkram.runner.__main__ import DEFAULT_IMAGE, ExecutorChoice, ImagePolicy, choose_executor

    if definition.image is None:
        executor = choose_executor(ExecutorChoice.process, ImagePolicy(), DEFAULT_IMAGE)
    else:
        try:
            executor = choose_executor(ExecutorChoice.docker, ImagePolicy(), DEFAULT_IMAGE)
        except InvalidInput as error:
            why = f"it runs an image, for which a container engine must be here, and {error.reason}"
            raise InvalidInput(what=f"The action {definition.name}", reason=why) from None
    note(f"Running {definition.name} {_ISOLATIONS[executor.abilities.isolation]}")
    return executor


def _pinned(executor: "Executor", definition: ActionDefinition, image: str) -> ActionDefinition:
    from kleinkram.runner.executors.base import CannotStart

    try:
        return definition.model_copy(update={"image": executor.prepare_image(image).reference})
    except CannotStart as error:
        note(error.ending.message)
        raise typer.Exit(ExitCode.run_failed) from None


def _show_local(ran: "LocalRun", as_json: bool) -> None:
    report = ran.results.report
    for problem in ran.results.problems:
        note(problem)
    if as_json:
        show_json(
            {
                "reason": ran.ending.reason.value,
                "message": ran.ending.message,
                "exit_code": ran.ending.exit_code,
                "artifacts": [vars(artifact) for artifact in ran.results.artifacts],
                "report": report,
            }
        )
    else:
        if report.metrics:
            show_metrics(report.metrics)
        if report.findings:
            show_findings(report.findings)
        for name, value in report.metadata.items():
            line(f"proposed {name}: {value}")
        note(f"{len(ran.results.artifacts)} artifacts in {ran.out}.")
    if ran.ending.reason is not EndReason.done:
        note(ran.ending.message)
        raise typer.Exit(ExitCode.run_failed)


@app.command("create")
def create(
    path: PathArgument,
    project: ProjectOption = None,
    new_version: Annotated[
        bool, typer.Option("--new-version", help="As the next version of the action that has its name.")
    ] = False,
    etag: IfMatch = None,
    as_json: AsJson = False,
) -> None:
    """Publish an action in a project, or without one for the whole lab; or the next version of one."""
    if etag is not None and not new_version:
        raise InvalidInput(what="--if-match", reason="it goes with --new-version")
    definition = read_manifest(path)
    with connect() as client:
        if new_version:
            made = _add_version(client, definition, project, etag)
        else:
            project_id = None if project is None else client.projects.get(project).id
            made = client.actions.create(definition, project_id=project_id)
    show_json(made) if as_json else show_action(made, made.latest)


def _add_version(client: Client, definition: ActionDefinition, project: str | None, etag: str | None) -> ActionRead:
    target = client.actions.get(definition.name, project=project)
    if target.latest.definition == definition:
        note(f"{target.name}@{target.latest.number} is this very definition; nothing was published.")
        return target
    return client.actions.add_version(target.id, definition, if_match=etag or target.etag)


@app.command("list")
def list_(
    name: Annotated[str | None, typer.Argument(metavar="GLOB", show_default=False)] = None,
    project: ProjectsOption = None,
    archived: Annotated[bool, typer.Option("--archived", help="Those that are archived.")] = False,
    limit: Limit = None,
    as_json: AsJson = False,
) -> None:
    """List actions: of all projects that you see, and the whole lab's."""
    with connect() as client:
        refs: list[str | None] = [*project] if project else [None]
        lists = [client.actions.list(name=name, project=ref, archived=archived, limit=limit) for ref in refs]
        rows = [*{row.id: row for rows in lists for row in rows}.values()][:limit]
    show_json_list(rows) if as_json else show_actions(rows)


@app.command("info")
def info(
    action: Annotated[str, typer.Argument(metavar="ACTION", help="Name, NAME@VERSION or id.", show_default=False)],
    project: ProjectOption = None,
    as_json: AsJson = False,
) -> None:
    """Show an action in its latest version, or in another: what it runs, reads and can be told."""
    name, number = split_version(action)
    with connect() as client:
        target = client.actions.get(name, project=project)
        version = client.actions.version(target, number)
    show_json({"action": target, "version": version}) if as_json else show_action(target, version)


@app.command("versions")
def versions(action: ActionArgument, project: ProjectOption = None, as_json: AsJson = False) -> None:
    """List the versions of an action, latest first; any of them can be run, as NAME@VERSION."""
    with connect() as client:
        rows = [*client.actions.versions(client.actions.get(action, project=project).id)]
    show_json_list(rows) if as_json else show_versions(rows)


@app.command("archive")
def archive(
    action: ActionArgument,
    project: ProjectOption = None,
    undo: Annotated[bool, typer.Option("--undo", help="Put it back.")] = False,
    etag: IfMatch = None,
    as_json: AsJson = False,
) -> None:
    """Take an action out of lists, so that nobody runs it anew; its versions and runs stay."""
    with connect() as client:
        target = client.actions.get(action, project=project)
        changed = client.actions.archive(target.id, archived=not undo, if_match=etag or target.etag)
    show_json(changed) if as_json else note(f"{'Put back' if undo else 'Archived'} the action {changed.name}.")
