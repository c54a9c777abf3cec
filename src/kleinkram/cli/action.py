"""`klein action`: what to run on the data."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.options import AsJson, MissionOption, ProjectOption
from kleinkram.cli.render import note, show_json, table
from kleinkram.client.errors import InvalidInput
from kleinkram.client.manifest import read_manifest
from kleinkram.contract.actions import ActionDefinition, ParameterValues
from kleinkram.contract.runners import Isolation
from kleinkram.contract.runs import EndReason

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def action() -> None:
    """Actions: run code on the files of a mission."""


@app.command("run-local")
def run_local(
    action: Annotated[Path, typer.Argument(metavar="ACTION", help="A script, or a folder with action.yaml.")],
    mission: MissionOption = None,
    project: ProjectOption = None,
    parameters: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A parameter; may be repeated.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where results go; empty or not there yet.")] = Path(
        "out"
    ),
    as_json: AsJson = False,
) -> None:
    """Run an action on this machine, on a mission: the same /in and /out as on a runner. Nothing is stored."""
    from kleinkram.cli.progress import watching
    from kleinkram.runner.local import run_locally
    from kleinkram.runner.process.executor import ProcessExecutor

    definition = read_manifest(action)
    if mission is None:
        raise InvalidInput(what="The command", reason="say which mission, with -m")
    executor = ProcessExecutor()
    if executor.abilities.isolation is Isolation.none:
        note("This kernel gives no namespaces to this user: the action can read and change whatever you can.")
    with connect() as client, watching() as watcher:
        found = client.missions.get(mission, project=project)
        run = run_locally(
            client,
            definition,
            found,
            _values(definition, parameters or []),
            executor=executor,
            out=out,
            show=_show_on_stderr,
            watcher=watcher,
        )
    report = run.results.report
    for problem in run.results.problems:
        note(problem)
    if as_json:
        show_json(
            {
                "reason": run.ending.reason.value,
                "message": run.ending.message,
                "exit_code": run.ending.exit_code,
                "artifacts": [vars(artifact) for artifact in run.results.artifacts],
                "report": report,
            }
        )
    else:
        if report.metrics:
            table(["metric", "value", "unit", "file"], [(m.name, m.value, m.unit, m.file) for m in report.metrics])
        if report.findings:
            rows = [(f.severity.value, f.code, f.message, f.file, f.topic) for f in report.findings]
            table(["severity", "finding", "message", "file", "topic"], rows)
        note(f"{len(run.results.artifacts)} artifacts in {out}.")
    if run.ending.reason is not EndReason.done:
        note(run.ending.message)
        raise typer.Exit(ExitCode.run_failed)


def _values(definition: ActionDefinition, said: list[str]) -> ParameterValues:
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
    return values


def _show_on_stderr(data: bytes) -> None:
    sys.stderr.write(data.decode(errors="replace"))
    sys.stderr.flush()
