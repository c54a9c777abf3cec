"""`klein action …`: create, list, try out and publish actions."""

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from pydantic import ValidationError

from kleinkram.cli import action_library, options
from kleinkram.cli.action_library import read_action
from kleinkram.cli.commands import Subcommands, Text, argument, flag, option
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.render import Output, as_list, as_table, details, line, note, table
from kleinkram.cli.run import launch
from kleinkram.cli.run_reports import split_version
from kleinkram.cli.run_view import show_results, write_log
from kleinkram.cli.units import duration, size
from kleinkram.client import Client
from kleinkram.client.actions import read_manifest
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import ActionDefinition, ActionRead, ActionVersionRead, Inputs
from kleinkram.contract.checks import Verdict
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.problems import first_problem
from kleinkram.contract.reports import verdict_of_report
from kleinkram.contract.runs import EndReason

if TYPE_CHECKING:
    from kleinkram.environments.uv import PackageIndex
    from kleinkram.runner.executors.base import Executor
    from kleinkram.runner.local_run import LocalRun

_NS = 10**9
_ISOLATIONS = {
    Isolation.container: "in a container.",
    Isolation.namespaces: "as a process in its own namespaces.",
    Isolation.none: "as a plain process, because this kernel allows you no namespaces: it can change whatever you can.",
}

app = Subcommands("Manage actions: what to run on the files of a mission.")
app.command("run")(launch)
app.command("library")(action_library.library)
app.command("add")(action_library.add)

PathArgument = Annotated[Path, argument("PATH", "A script, or a folder with action.yaml.")]
PathOrShippedArgument = Annotated[
    Path, argument("PATH", "A script, a folder with action.yaml, or a shipped action, such as kleinkram/preview.")
]
ActionArgument = Annotated[str, argument("ACTION", "Name or id of the action.")]
LockOption = Annotated[
    Path | None, option("--lock", "FILE", "Install the dependencies in the versions of this lock.", dir_okay=False)
]
IndexOption = Annotated[
    Text,
    option(
        "--package-index",
        "URL",
        "Install dependencies from this index or folder of wheels; off: use those of this machine. "
        "Default: KLEINKRAM_PACKAGE_INDEX, else PyPI.",
    ),
]


@app.command("run-local")
def run_local(
    client: Client,
    action: PathOrShippedArgument,
    mission: options.MissionOption = None,
    project: options.ProjectOption = None,
    parameters: options.SetOption = None,
    out: Annotated[Path, option("--out", "DIR", "Write results to DIR, which must be empty or new.")] = Path("out"),
    lock: LockOption = None,
    package_index: IndexOption = None,
    no_build: Annotated[bool, flag("--no-build", "Use the existing image, even if there is a Dockerfile.")] = False,
    ignore_verdict: Annotated[bool, flag("--ignore-verdict", "Exit with 0 also if the verdict is bad.")] = False,
) -> Output:
    """Run an action on this machine, on a mission, with the same /in and /out as on a runner. Nothing is stored.

    An action with an image runs in a container. The image is built first if a Dockerfile is beside the manifest. Other
    actions run as a process. The exit code is 15 if the run says that the mission is bad.
    """
    from kleinkram.cli.transfer import watching
    from kleinkram.runner.local_run import run_locally

    definition = read_action(action)
    values = options.parameter_values(definition, parameters or [])
    if mission is None:
        raise InvalidInput(what="The command", reason="specify a mission with -m")
    index = _index(package_index)
    definition = _locked(_with_lock_file(definition, lock), index)
    executor = _executor(definition, index)
    if definition.image is not None:
        if not no_build:
            _build(action if action.is_dir() else action.parent, definition.image)
        definition = _pinned(executor, definition, definition.image)
    target = client.missions.get(mission, project=project)
    with watching() as watcher:
        ran = run_locally(
            client,
            definition,
            target,
            values,
            executor=executor,
            out=out,
            show=lambda data: write_log(data.decode(errors="replace"), sys.stderr),
            watcher=watcher,
        )
    return _local_output(ran, ignore_verdict=ignore_verdict)


def _index(text: str | None) -> "PackageIndex | None":
    from kleinkram.environments.local import local_index

    try:
        return local_index(text)
    except ValueError as error:
        raise InvalidInput(what="The package index", reason=str(error)) from None


def _with_lock_file(definition: ActionDefinition, lock: Path | None) -> ActionDefinition:
    """Return a definition with the lock in a file."""
    if lock is None:
        return definition
    try:
        return ActionDefinition.model_validate({**definition.model_dump(), "lock": lock.read_text()})
    except ValidationError as error:
        raise InvalidInput(what=str(lock), reason=first_problem(error, "the action")) from error
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise InvalidInput(what=str(lock), reason=f"cannot be read: {reason}") from error


def _locked(definition: ActionDefinition, index: "PackageIndex | None") -> ActionDefinition:
    """Return a definition with a lock of its dependencies, if it has any and there is an index."""
    from kleinkram.environments.local import with_lock
    from kleinkram.environments.lock import CannotLock

    try:
        return with_lock(definition, index, time.sleep)
    except CannotLock as error:
        raise InvalidInput(
            what=f"The action {definition.name}", reason=f"cannot be locked: {str(error).removesuffix('.')}"
        ) from None


def _executor(definition: ActionDefinition, index: "PackageIndex | None") -> "Executor":
    from kleinkram.environments.local import local_environments
    from kleinkram.runner.arguments import DEFAULT_IMAGE, ExecutorChoice
    from kleinkram.runner.choose_executor import ImagePolicy, choose_executor

    choice = ExecutorChoice.process if definition.image is None else ExecutorChoice.docker
    try:
        environments = local_environments(index) if index is not None and definition.lock is not None else None
        executor = choose_executor(choice, ImagePolicy(), DEFAULT_IMAGE, environments=environments)
    except InvalidInput as error:
        if definition.image is None:
            raise
        why = f"it runs an image, which requires a container engine, and {error.reason}"
        raise InvalidInput(what=f"The action {definition.name}", reason=why) from None
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}"
        raise InvalidInput(what="The folder for packages", reason=reason) from error
    note(f"Running {definition.name} {_ISOLATIONS[executor.abilities.isolation]}")
    return executor


def _build(folder: Path, image: str) -> None:
    """Build the image of a folder with a Dockerfile, with docker or podman, and print its output on stderr."""
    if not (folder / "Dockerfile").is_file():
        return
    engine = shutil.which("docker") or shutil.which("podman")
    if engine is None:
        note(f"There is neither docker nor podman to build {image}: the existing image is used.")
        return
    note(f"Building {image} from {folder}; --no-build uses the existing image.")
    done = subprocess.run([engine, "build", "--tag", image, str(folder)], stdout=sys.stderr, check=False)
    if done.returncode != 0:
        raise InvalidInput(what=f"The folder {str(folder)!r}", reason="no image can be built from it")


def _pinned(executor: "Executor", definition: ActionDefinition, image: str) -> ActionDefinition:
    from kleinkram.runner.executors.base import CannotStart

    try:
        return definition.model_copy(update={"image": executor.prepare_image(image).reference})
    except CannotStart as error:
        note(error.ending.message)
        raise typer.Exit(ExitCode.run_failed) from None


def _local_output(ran: "LocalRun", *, ignore_verdict: bool) -> Output:
    report = ran.results.report
    for problem in ran.results.problems:
        note(problem)

    def show() -> None:
        show_results(report.checks, report.metrics, report.findings)
        for name, value in report.metadata.items():
            line(f"proposed {name}: {value}")
        note(f"{len(ran.results.artifacts)} artifacts in {ran.out}.")

    is_done = ran.ending.reason is EndReason.done
    verdict = verdict_of_report(report) if is_done else None
    if not is_done:
        note(ran.ending.message)
    elif verdict in {Verdict.warnings, Verdict.bad}:
        note(f"The verdict is {verdict.value}.")
    document = {
        "reason": ran.ending.reason.value,
        "message": ran.ending.message,
        "exit_code": ran.ending.exit_code,
        "artifacts": [vars(artifact) for artifact in ran.results.artifacts],
        "verdict": verdict,
        "report": report,
    }
    exit_code = 0 if is_done else ExitCode.run_failed
    return Output(document, show, ExitCode.verdict_bad if verdict is Verdict.bad and not ignore_verdict else exit_code)


@app.command("create")
def create(
    client: Client,
    path: PathArgument,
    project: options.ProjectOption = None,
    new_version: Annotated[
        bool, flag("--new-version", "Publish the next version of the action with this name.")
    ] = False,
    lock: LockOption = None,
    etag: options.IfMatch = None,
) -> Output:
    """Publish an action, or its next version, in a project. Without a project, publish it for the whole lab.

    The server locks the dependencies of a script, unless you pass your own lock.
    """
    if etag is not None and not new_version:
        raise InvalidInput(what="--if-match", reason="it requires --new-version")
    definition = _with_lock_file(read_manifest(path), lock)
    if not new_version:
        made = client.actions.create(definition, project=project)
        return Output(made, lambda: _show(made, made.latest))
    action = client.actions.get(definition.name, project=project)
    published = client.actions.add_version(action.id, definition, if_match=etag or action.etag)
    if published.latest.number == action.latest.number:
        note(f"{action.name}@{action.latest.number} has this definition already; nothing was published.")
    return Output(published, lambda: _show(published, published.latest))


@app.command("lock")
def lock_(
    path: PathOrShippedArgument,
    out: Annotated[Path | None, option("--out", "FILE", "Write the lock to FILE. Default: print it.")] = None,
    package_index: IndexOption = None,
) -> Output:
    """Lock the dependencies of a script: one version of each package, with hashes, for `--lock` of other commands."""
    definition = read_action(path)
    index = _index(package_index)
    if index is None:
        raise InvalidInput(what="The package index", reason="it is off")
    lock = _locked(definition.model_copy(update={"lock": None}), index).lock
    if lock is None:
        raise InvalidInput(what=f"The action {definition.name}", reason="it has no dependencies to install")
    if out is not None:
        try:
            out.write_text(lock)
        except OSError as error:
            raise InvalidInput(what=str(out), reason=error.strerror or str(error)) from None
    packages = _packages_of(lock)
    document = {"packages": packages, "lock": lock}
    if out is not None:
        return Output(document, f"Locked {len(packages)} packages in {out}.")
    return Output(document, lambda: sys.stdout.write(lock))


@app.command("list")
def list_(
    client: Client,
    name: options.GlobArgument = None,
    project: options.ProjectsOption = None,
    archived: Annotated[bool, flag("--archived", "List archived actions.")] = False,
    limit: options.Limit = None,
) -> Output:
    """List the actions of all projects that you can see, and of the whole lab."""
    refs: list[str | None] = [*project] if project else [None]
    lists = [client.actions.list(name=name, project=ref, archived=archived, limit=limit) for ref in refs]
    rows = [*{row.id: row for rows in lists for row in rows}.values()][:limit]
    return as_list(rows, _show_actions)


@app.command("info")
def info(
    client: Client,
    action: Annotated[str, argument("ACTION", "Name, NAME@VERSION or id of the action.")],
    project: options.ProjectOption = None,
) -> Output:
    """Show an action in its latest version, or in another: its definition, inputs and parameters."""
    name, number = split_version(action)
    target = client.actions.get(name, project=project)
    version = client.actions.version(target, number or target.latest.number)
    return Output({"action": target, "version": version}, lambda: _show(target, version))


@app.command("versions")
def versions(client: Client, action: ActionArgument, project: options.ProjectOption = None) -> Output:
    """List the versions of an action, latest first. Run one as NAME@VERSION."""
    return as_table(
        client.actions.versions(client.actions.get(action, project=project).id),
        ["version", "runs", "digest", "published", "by", "id"],
        lambda row: (
            row.number,
            _code(row.definition),
            row.image_digest,
            row.created_at,
            row.created_by.name,
            row.id,
        ),
    )


@app.command("archive")
def archive(
    client: Client,
    action: ActionArgument,
    project: options.ProjectOption = None,
    undo: Annotated[bool, flag("--undo", "Restore it to lists.")] = False,
    etag: options.IfMatch = None,
) -> Output:
    """Remove an action from lists, so that nobody runs it again. Its versions and runs stay."""
    target = client.actions.get(action, project=project)
    changed = client.actions.archive(target.id, archived=not undo, if_match=etag or target.etag)
    return Output(changed, f"{'Restored' if undo else 'Archived'} the action {changed.name}.")


def _show_actions(actions: Iterable[ActionRead]) -> None:
    table(
        ["project", "action", "version", "runs", "from", "description", "changed", "by", "id"],
        [
            (
                row.project.name if row.project else "(whole lab)",
                row.name,
                row.latest.number,
                _code(row.latest.definition),
                (row.latest.definition.library or "").partition("@")[0],
                row.description.partition("\n")[0],
                row.latest.created_at,
                row.latest.created_by.name,
                row.id,
            )
            for row in actions
        ],
    )


def _show(action: ActionRead, version: ActionVersionRead) -> None:
    definition, resources = version.definition, version.definition.resources
    locked = len({text.partition("==")[0] for text in version.packages})
    details(
        [
            ("action", f"{action.name}@{version.number}"),
            ("of", action.project.name if action.project else "the whole lab"),
            ("id", action.id),
            ("archived", "yes: it is not listed and starts no runs" if action.archived else None),
            ("description", action.description),
            ("runs", _code(definition)),
            ("digest", version.image_digest),
            ("command", definition.command),
            ("needs", definition.dependencies),
            ("python", definition.requires_python),
            ("locked", f"{locked} packages" if locked else None),
            ("inputs", _inputs(definition.inputs)),
            (
                "resources",
                f"{resources.cores:g} cores, {size(resources.memory_bytes)} memory, {size(resources.disk_bytes)} disk, "
                f"{resources.gpus} GPUs, {duration(resources.time_s * _NS)} at most",
            ),
            ("runners", resources.labels),
            ("network", definition.network.value),
            ("right", definition.right.value),
            ("from", definition.library),
            ("published", f"{version.created_at:%Y-%m-%d %H:%M}Z by {version.created_by.name}"),
            ("etag", action.etag),
        ]
    )
    if definition.parameters:
        line("")
        rows = []
        for entry in definition.parameters:
            default = "(required)" if entry.default is None else '""' if entry.default == "" else entry.default
            rows.append((entry.name, entry.type.value, default, entry.unit, entry.choices, entry.description))
        table(["parameter", "type", "default", "unit", "choices", "description"], rows)
    if definition.metrics:
        line("")
        metrics = [(entry.name, entry.unit, entry.better.value, entry.description) for entry in definition.metrics]
        table(["metric", "unit", "better", "description"], metrics)


def _packages_of(lock: str) -> list[str]:
    from kleinkram.contract.locks import parse_lock  # slow to import

    return sorted({package.name for package in parse_lock(lock)})


def _inputs(inputs: Inputs) -> str:
    lists = [("files", inputs.paths), ("with topics", inputs.topics), ("of types", inputs.message_types)]
    files = "; ".join(f"{what} {', '.join(globs)}" for what, globs in lists if globs) or "all files"
    parts = [files, *(["also files that runs made"] if inputs.derived else [])]
    parts += [f"metadata {', '.join(inputs.metadata)}"] if inputs.metadata else []
    parts += ["checks.yaml of the project, with all metadata"] if inputs.checks else []
    return "; ".join([*parts, *(["the reference of the mission"] if inputs.reference else [])])


def _code(definition: ActionDefinition) -> str:
    if definition.script is None:
        return definition.image or ""
    return "a script" if definition.image is None else f"a script on {definition.image}"


# The files of `klein action init`.
_HEADER = """\
# /// script
# requires-python = ">=3.10"
# dependencies = ["open-kleinkram"]
#
# [tool.kleinkram]
# name = "{name}"
# description = "Counts the messages of each topic."
# inputs = {{paths = ["*.mcap", "*.bag", "*.db3"]}}
# parameters = [{{name = "topics", type = "string", default = "*", description = "Only topics whose name matches."}}]
# resources = {{memory = "1GB", time = "30m"}}
# ///
"""

_CODE = '''\
"""Counts the messages of each topic."""

from collections import Counter

from kleinkram.action import inputs, out, parameters, progress, report
from kleinkram.recordings import NotARecording, Recording


def main() -> None:
    lines = ["file,topic,messages"]
    for number, path in enumerate(inputs()):
        progress(number / len(inputs()), path.name)
        print("reading", path.name, flush=True)
        try:
            with Recording.open(path) as recording:
                counts = Counter(message.topic for message in recording.raw_messages(str(parameters()["topics"])))
        except NotARecording as error:
            report.finding("error", "file.unreadable", str(error), file=path)
            continue
        lines += [f"{path.name},{topic},{count}" for topic, count in sorted(counts.items())]
        report.metric("messages", counts.total(), file=path)
        if not counts:
            report.finding("warning", "topics.none", "has no message of a matching topic", file=path)
    table = out / "topics.csv"
    table.write_text("\\n".join(lines) + "\\n")
    report.preview(table, "Messages of each topic")


if __name__ == "__main__":
    main()
'''

_TEST = '''\
"""Tests of the action. They need neither a server nor a container."""

from pathlib import Path

from kleinkram.action.testing import try_out
from kleinkram.recordings.sample import generate_mcap

MAIN = Path(__file__).with_name("main.py")


def test_messages_are_counted(tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "drive.mcap", duration_s=1)
    (tmp_path / "run").mkdir()
    files = {"day/drive.mcap": truth.path, "notes.mcap": b"not a recording"}

    ran = try_out(MAIN, tmp_path / "run", files=files, parameters={"topics": "/imu*"})

    assert ran.exit_code == 0, ran.log
    imu = next(topic.count for topic in truth.topics if topic.name == "/imu/data")
    assert ran.metric("messages", "day/drive.mcap") == imu
    assert ran.codes() == {"file.unreadable"}
    assert f"drive.mcap,/imu/data,{imu}" in (ran.out / "topics.csv").read_text()
'''

_MANIFEST = """\
name: {name}
description: Counts the messages of each topic.
image: {image}
command: [python3, /action/main.py]
inputs:
  paths: ["*.mcap", "*.bag", "*.db3"]
parameters:
  - {{name: topics, type: string, default: "*", description: Only topics whose name matches.}}
resources: {{cores: 1, memory: 1GB, disk: 1GB, time: 30m}}
network: none
"""

_DOCKERFILE = """\
# The image of script actions, with open-kleinkram; deploy/images/action-python in Kleinkram's repository makes it.
ARG BASE={base}
FROM ${{BASE}}
COPY main.py /action/main.py
CMD ["python3", "/action/main.py"]
"""

DEFAULT_IMAGE = "kleinkram/action-python:latest"


@app.command("init")
def init(
    directory: Annotated[Path, argument("DIR", "Folder to create.")],
    image: Annotated[bool, flag("--image", "Create an action with its own image, not a script.")] = False,
) -> Output:
    """Create a small example action: its code, its manifest, and a test that passes."""
    what = f"The folder {str(directory)!r}"
    name = re.sub(r"[^a-z0-9]+", "-", directory.resolve().name.lower()).strip("-")[:64]
    if not name:
        raise InvalidInput(what=what, reason="its name has no letters or digits for the name of the action")
    files = {"main.py": _CODE, f"test_{name.replace('-', '_')}.py": _TEST}
    if image:
        files["action.yaml"] = _MANIFEST.format(name=name, image=f"{name}:1")
        files["Dockerfile"] = _DOCKERFILE.format(base=DEFAULT_IMAGE)
    else:
        files["main.py"] = _HEADER.format(name=name) + _CODE
    if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
        raise InvalidInput(what=what, reason="it exists already; specify a new or empty folder")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for path, text in files.items():
            (directory / path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InvalidInput(what=what, reason=error.strerror or str(error)) from None
    note(f"Created the action {name} in {directory}: {', '.join(sorted(files))}.")
    build = [f"docker build -t {name}:1 {directory}"] if image else []
    run = f"klein action run-local {directory} -m MISSION"
    for step in [f"pytest {directory}", *build, run, f"klein action run {directory} -m MISSION --follow"]:
        note(f"  {step}")
    return Output({"name": name, "files": [str(directory / path) for path in sorted(files)]})
