"""`klein check` and `klein checks …`: the rules of `checks.yaml`, applied to local recordings without a server."""

import json
import os
import shutil
import sys
import textwrap
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import JsonValue

from kleinkram.checks.document import ChecksDocument, json_schema, read_checks, reference_of
from kleinkram.cli import options
from kleinkram.cli.commands import Many, Subcommands, argument, flag, option
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.render import Output, as_table, line, note
from kleinkram.cli.verdicts import show_matrix, show_mission_checks, show_trend
from kleinkram.client import Client, connect
from kleinkram.client.errors import (
    ChecksInvalid,
    ClientError,
    DestinationRefused,
    InvalidInput,
    NoChecks,
    NothingToDo,
)
from kleinkram.contract.checks import Check, CheckDepth, CheckStatus, Verdict
from kleinkram.contract.errors import YamlInvalid
from kleinkram.untrusted_yaml import read_yaml, resolve_plain

if TYPE_CHECKING:
    from kleinkram.checks.local import LocalMission
    from kleinkram.checks.results import CheckResults

CHECKS_NAME = "checks.yaml"
WARNINGS, ERRORS = 1, 2
"""Exit codes of `klein check`; `ExitCode.not_found` where nothing was checked."""

app = Subcommands("Make checks.yaml, the rules that recordings must pass, and manage that of a project.")

ChecksOption = Annotated[
    Path | None, option("--checks", "FILE", "The rules; by default checks.yaml in or beside the first path.")
]
MetadataOption = Annotated[
    Path | None, option("--metadata", "mission.yaml", "Metadata of the mission, by which profiles are chosen.")
]
MetadataValueOption = Annotated[
    Many, option("--where -w", "FIELD=VALUE", "A metadata value, such as robot=anymal-d; repeatable.")
]


def check(
    paths: Annotated[list[str], argument("PATH", "Files and folders of one mission.")],
    checks: ChecksOption = None,
    project: options.ProjectOption = None,
    metadata: MetadataOption = None,
    where: MetadataValueOption = None,
    index_only: Annotated[bool, flag("--index-only", "Read no messages: only what the indexes of files say.")] = False,
    strict: Annotated[bool, flag("--strict", "End with exit code 1 if there are warnings.")] = False,
    all_: Annotated[bool, flag("--all", "List the checks that passed, too.")] = False,
    exclude: options.ExcludeOption = None,
) -> Output:
    """Check local recordings of one mission by the rules of checks.yaml. Needs no server, unless -p names a project.

    The exit code is 0 if the recordings are good, 1 for warnings with --strict, 2 for errors, 3 if there are no rules
    for them, 6 if checks.yaml is wrong, and 8 if a path does not exist. A check that could not be made is a warning.
    """
    if project is None:
        loaded = load_checks(checks, paths[0])
    elif checks is not None:
        raise InvalidInput(what="--checks and -p", reason="specify a file or a project")
    else:
        with connect() as client:
            loaded = project_checks(client, project)
    values = mission_metadata(metadata, where)
    files = mission_files([as_contents(paths)] if len(paths) == 1 else paths, exclude or [])
    results = run_checks(loaded.document, files, values, CheckDepth.index if index_only else CheckDepth.content)
    reference = reference_of(loaded.document, values)
    document = {"checks_file": loaded.source, "reference": reference, **results.to_plain()}

    def show() -> None:
        show_results(results, loaded.source, list_all=all_)
        if reference is not None:
            line(f"Reference: {reference}")

    return Output(document, show, exit_code_of(results, strict))


def as_contents(paths: Sequence[str]) -> str:
    """Return a single folder as the path of its contents, so that it is the mission and not a folder in it."""
    (path,) = paths
    return f"{path.rstrip('/')}/" if Path(path).is_dir() and path.strip("/") else path


@dataclass(frozen=True)
class LoadedChecks:
    """A `checks.yaml`. `source`: its path, or the project that it is of."""

    document: ChecksDocument
    text: str
    source: str


@dataclass(frozen=True)
class MissionFiles:
    """The local files of one mission, by their paths in it; `left_out` cannot be checked."""

    files: Mapping[str, Path]
    left_out: Sequence[ClientError]


def load_checks(path: Path | None, beside: str) -> LoadedChecks:
    """Return the rules of a file, or of the `checks.yaml` in or beside a path.

    Raises:
        NoChecks: there is no such file.
        ChecksInvalid: its text is wrong, with line and column.
        InvalidInput: it cannot be read.
    """
    path = path or _file_beside(Path(beside))
    text = options.read_text(path) or ""
    return LoadedChecks(parse_checks(text, str(path)), text, str(path))


def project_checks(client: Client, project: str | uuid.UUID) -> LoadedChecks:
    """Return the rules of a project. Raises NothingToDo if it has none."""
    target = client.projects.get(project)
    text = client.checks.get(target.id).text
    if not text:
        raise NothingToDo(reason=f"The project {target.name} has no checks; `klein checks set` sets them")
    source = f"checks of {target.name}"
    return LoadedChecks(parse_checks(text, source), text, source)


def parse_checks(text: str, source: str) -> ChecksDocument:
    """Return the document of a text. Raises ChecksInvalid."""
    try:
        return read_checks(text)
    except YamlInvalid as error:
        raise _invalid(source, error) from error


def _invalid(source: str, error: YamlInvalid) -> ChecksInvalid:
    return ChecksInvalid(source=source, line=error.line, column=error.column, reason=error.reason)


def _file_beside(path: Path) -> Path:
    """Return the checks.yaml in a folder, beside a file or folder, or in the working directory."""
    folders = [*([path] if path.is_dir() else []), path.absolute().parent, Path()]
    for folder in folders:
        if (folder / CHECKS_NAME).is_file():
            return folder / CHECKS_NAME
    raise NoChecks(path=str(path))


def mission_metadata(path: Path | None, values: Sequence[str] | None) -> dict[str, JsonValue]:
    """Return the metadata of a file, with single values over them. Raises ChecksInvalid."""
    metadata = metadata_of(options.read_text(path), str(path))
    for value in values or ():
        name, equals, content = value.partition("=")
        if not equals or not name:
            raise InvalidInput(what=f"--where {value!r}", reason="write FIELD=VALUE, such as robot=anymal-d")
        try:
            metadata[name] = resolve_plain(content)
        except ValueError:  # a number that is too large
            metadata[name] = content
    return metadata


def metadata_of(text: str | None, source: str) -> dict[str, JsonValue]:
    """Return the metadata of a document; none without a text. Raises ChecksInvalid."""
    if text is None:
        return {}
    try:
        document = read_yaml(text).value
    except YamlInvalid as error:
        raise _invalid(source, error) from error
    if document is not None and not isinstance(document, dict):
        raise ChecksInvalid(source=source, line=1, column=1, reason="it must have FIELD: VALUE, one a line")
    return document or {}


def mission_files(paths: Sequence[str], exclude: Sequence[str] = ()) -> MissionFiles:
    """Return the files that an upload of these paths would send, also those that are still being recorded."""
    from kleinkram.client.transfer.plan import plan_upload

    for path in paths:
        if not Path(path).exists():
            raise FileNotFoundError(f"{path}: there is no such file or folder")
    plan = plan_upload(paths, include_active=True, exclude=exclude)
    return MissionFiles({file.path: file.source for file in plan.files}, plan.left_out)


def run_checks(
    document: ChecksDocument, files: MissionFiles, metadata: Mapping[str, JsonValue], depth: CheckDepth
) -> "CheckResults":
    """Check local files; a file that cannot be read is a check that could not be made."""
    from kleinkram.checks.local import read_mission

    return check_mission(document, read_mission(files.files, metadata), files.left_out, depth)


def check_mission(
    document: ChecksDocument, mission: "LocalMission", unusable: Sequence[ClientError], depth: CheckDepth
) -> "CheckResults":
    """Check a mission that was read; `unusable`: files that do not belong to it, because they cannot be read."""
    from kleinkram.checks.outcomes import make_check
    from kleinkram.checks.results import evaluate

    left_out = [make_check("file.incomplete", CheckStatus.not_made, str(error)) for error in unusable]
    return evaluate(document, mission, depth, more=left_out)


def exit_code_of(results: "CheckResults", strict: bool) -> int:
    """Return the exit code of `klein check`."""
    if results.verdict is Verdict.unchecked and not results.counts.get(CheckStatus.ok, 0):
        return ExitCode.not_found
    if results.verdict is Verdict.bad:
        return ERRORS
    return WARNINGS if strict and results.verdict is Verdict.warnings else 0


# -- output -----------------------------------------------------------------------------------------------------------

_STATUS_WORDS = {
    CheckStatus.error: "error",
    CheckStatus.warning: "warning",
    CheckStatus.not_made: "not made",
    CheckStatus.ok: "ok",
    CheckStatus.needs_content: "not read",
}
_HIDDEN = (CheckStatus.ok, CheckStatus.needs_content)


def show_results(results: "CheckResults", source: str, *, list_all: bool) -> None:
    """Print the checks that did not pass, the verdict, and what was not applied or not listed."""
    for text in results_text(results, source, list_all=list_all):
        line(text)
    if results.verdict is Verdict.unchecked:
        note(_why_unchecked(results))
    if results.counts.get(CheckStatus.ok, 0) and not list_all:
        note("--all lists the checks that passed.")


def results_text(results: "CheckResults", source: str, *, list_all: bool = False) -> Iterator[str]:
    """Yield the checks that did not pass as lines, the verdict, and the rules."""
    shown = [check for check in results.checks if list_all or check.status not in _HIDDEN]
    yield from _check_lines(shown)
    if shown:
        yield ""
    yield f"Verdict: {results.verdict.value}{_counts_text(results)}"
    profiles = ", ".join(results.profiles_applied) or "none"
    yield f"Rules:   {source} ({'profile' if len(results.profiles_applied) == 1 else 'profiles'}: {profiles})"
    for profile in results.profiles_left_out:
        yield f"         not applied: {profile.name}, because {profile.reason}"


def _why_unchecked(results: "CheckResults") -> str:
    if not results.profiles_applied:
        return "Nothing was checked: no profile applies. Name the metadata of the mission with -w FIELD=VALUE."
    if results.counts.get(CheckStatus.ok, 0):
        return "All checks from the index passed; those of the messages were not made. Leave out --index-only."
    if results.counts.get(CheckStatus.needs_content, 0):
        return "Nothing was checked: all rules are about messages, which were not read. Leave out --index-only."
    return "Nothing was checked: the profiles have no rules."


def _counts_text(results: "CheckResults") -> str:
    counts = results.counts
    parts = [
        _counted(counts.get(CheckStatus.error, 0), "error"),
        _counted(counts.get(CheckStatus.warning, 0), "warning"),
        f"{counts.get(CheckStatus.not_made, 0)} could not be made",
        f"{counts.get(CheckStatus.ok, 0)} passed",
        f"{counts.get(CheckStatus.needs_content, 0)} need the messages",
    ]
    listed = [part for part in parts if not part.startswith("0 ")]
    return f" ({', '.join(listed)})" if listed else ""


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun if number == 1 else f'{noun}s'}"


def _check_lines(checks: Sequence[Check]) -> Iterator[str]:
    """Yield a line for each check; on a terminal, a long message continues below. Nothing is cut."""
    rows = [(_STATUS_WORDS[check.status], check.name, _where(check), check.message) for check in checks]
    if not rows:
        return
    headers = ("RESULT", "CHECK", "WHERE", "")
    widths = [max(len(row[column]) for row in [headers, *rows]) for column in range(3)]
    columns = shutil.get_terminal_size().columns if _is_terminal() else None
    for row in [headers, *rows]:
        cells = "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=False))
        text = f"{cells}  {row[3]}".rstrip()
        if columns is None or len(text) <= columns:
            yield text
            continue
        yield cells.rstrip()
        indent = " " * (widths[0] + 2)
        yield from (f"{indent}{part}" for part in textwrap.wrap(row[3], max(40, columns - len(indent))))


def _is_terminal() -> bool:
    return sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()


def _where(check: Check) -> str:
    return " in ".join(part for part in (check.topic, check.file) if part)


# -- klein checks -----------------------------------------------------------------------------------------------------


@app.command("init")
def init(
    paths: Annotated[list[str], argument("PATH", "Missions that are known to be good, each a folder or a file.")],
    output: Annotated[Path | None, option("--output -o", "FILE", "Write to this new file instead of stdout.")] = None,
) -> Output:
    """Write a first checks.yaml from good missions: their topics, rates, gaps and computers, with margins.

    With the extra `reading`, samples of messages say which axis of an IMU points up. Read it and change it: it is only
    as good as the missions that it was made from.
    """
    from kleinkram.checks.local import read_mission
    from kleinkram.checks.suggest import measure_up_axes, suggest_checks

    missions = [read_mission(mission_files([as_contents([path])]).files) for path in paths]
    try:
        text = suggest_checks([mission.facts for mission in missions], measure_up_axes(missions))
    except ValueError as error:
        raise NothingToDo(reason=f"There is nothing to make rules from: {error}") from None
    if output is None:
        return Output({"text": text}, lambda: sys.stdout.write(text))
    try:
        with output.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise DestinationRefused(path=str(output), reason="it exists; remove it, or choose another name") from None
    except OSError as error:
        raise DestinationRefused(path=str(output), reason=error.strerror or str(error)) from None
    return Output({"text": text, "path": str(output)}, f"Wrote {output}. Read it, then: klein check PATH")


@app.command("schema")
def schema() -> None:
    """Print the JSON schema of checks.yaml, for editors."""
    json.dump(json_schema(), sys.stdout, indent=1, ensure_ascii=False)
    sys.stdout.write("\n")


# -- the checks of a project ------------------------------------------------------------------------------------------

_Project = Annotated[str, option("--project -p", "PROJECT", "The project.", autocompletion=options.complete_project)]
_Number = Annotated[int | None, option("--number", "N", "A version of its history; the latest by default.", min=1)]


@app.command("set")
def set_(
    client: Client,
    project: _Project,
    file: Annotated[Path | None, argument("FILE", "The new checks.yaml.")] = None,
    remove: Annotated[bool, flag("--remove", "Remove the checks of the project instead.")] = False,
    etag: options.IfMatch = None,
) -> Output:
    """Set the checks of a project: a new version, by which all its missions are checked again."""
    if (file is None) is not remove:
        raise InvalidInput(what="The command", reason="specify a FILE, or --remove")
    text = options.read_text(file) or ""
    if file is not None:
        parse_checks(text, str(file))
    target = client.projects.get(project)
    old = client.checks.get(target.id)
    new = client.checks.set(target.id, text, if_match=etag or old.etag)
    if new.number == old.number:
        return Output(new, f"These are the checks of {target.name} already (number {new.number}).")
    what = f"Removed the checks of {target.name}" if remove else f"Set the checks of {target.name}"
    return Output(new, f"{what} (number {new.number}). Its missions are being checked again.")


@app.command("get")
def get(
    client: Client,
    project: _Project,
    number: _Number = None,
    output: Annotated[Path | None, option("--output -o", "FILE", "Write to this file instead of stdout.")] = None,
    overwrite: options.Overwrite = False,
) -> Output:
    """Print the checks of a project, or write them to a file, such as on a robot."""
    target = client.projects.get(project)
    checks = client.checks.get(target.id) if number is None else client.checks.version(target.id, number)
    if not checks.text:
        raise NothingToDo(reason=f"The project {target.name} has no checks; `klein checks set` sets them")
    if output is None:
        return Output(checks, lambda: sys.stdout.write(checks.text))
    return Output(checks, _write_text(output, checks.text, overwrite=overwrite))


def _write_text(path: Path, text: str, *, overwrite: bool) -> str:
    """Write a text to a file; return what to say about it."""
    if path.exists() and options.read_text(path) == text:
        return f"{path} is up to date."
    if path.exists() and not overwrite:
        raise DestinationRefused(path=str(path), reason="it exists and differs; --overwrite replaces it")
    try:
        path.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise DestinationRefused(path=str(path), reason=error.strerror or str(error)) from None
    return f"Wrote {path}."


@app.command("diff")
def diff(
    client: Client,
    project: _Project,
    file: Annotated[Path, argument("FILE", "A checks.yaml on this machine.")],
    number: _Number = None,
) -> Output:
    """Show how a file differs from the checks of a project: what `klein checks set` would change."""
    target = client.projects.get(project)
    difference = client.checks.diff(target.id, options.read_text(file) or "", number=number)

    def show() -> None:
        for text in difference.splitlines():
            line(text)
        if not difference:
            note(f"{file} does not differ from the checks of {target.name}.")

    return Output({"differs": bool(difference), "diff": difference}, show)


@app.command("history")
def history(client: Client, project: _Project, limit: options.Limit = None) -> Output:
    """List the versions of a project's checks, latest first."""
    return as_table(
        client.checks.history(project, limit=limit),
        ["number", "set at", "by", "removed", "sha256"],
        lambda row: (row.number, row.created_at, row.created_by.name, row.is_removal or None, row.sha256[:12]),
    )


app.command("mission")(show_mission_checks)
app.command("matrix")(show_matrix)
app.command("trend")(show_trend)
