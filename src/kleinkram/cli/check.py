"""`klein check` and `klein checks …`: the rules of `checks.yaml`, applied to local recordings without a server."""

import json
import os
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import JsonValue

from kleinkram.checks.document import ChecksDocument, json_schema, read_checks
from kleinkram.cli import options
from kleinkram.cli.commands import Many, Subcommands, argument, flag, option
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.render import Output, line, note
from kleinkram.cli.verdicts import show_matrix, show_mission_checks, show_trend
from kleinkram.client.errors import ChecksInvalid, ClientError, DestinationRefused, InvalidInput, NoChecks
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
    loaded = load_checks(checks, project, paths[0])
    values = mission_metadata(metadata, where)
    files = mission_files([as_contents(paths)] if len(paths) == 1 else paths, exclude or [])
    results = run_checks(loaded.document, files, values, CheckDepth.index if index_only else CheckDepth.content)
    document = {"checks_file": loaded.source, **results.to_plain()}
    return Output(document, lambda: show_results(results, loaded.source, list_all=all_), exit_code_of(results, strict))


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


def load_checks(path: Path | None, project: str | None, beside: str) -> LoadedChecks:
    """Return the rules of a file, or of the `checks.yaml` in or beside a path.

    Raises:
        NoChecks: there is no such file.
        ChecksInvalid: its text is wrong, with line and column.
        InvalidInput: it cannot be read, or both a file and a project were named.
    """
    if project is not None:
        raise InvalidInput(what="-p", reason="projects have no checks yet")
    path = path or _file_beside(Path(beside))
    text = options.read_text(path) or ""
    return LoadedChecks(parse_checks(text, str(path)), text, str(path))


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
    """Return the metadata of a file, with single values over them."""
    text = options.read_text(path)
    metadata: dict[str, JsonValue] = {}
    if text is not None:
        try:
            document = read_yaml(text).value
        except YamlInvalid as error:
            raise _invalid(str(path), error) from error
        if isinstance(document, dict):
            metadata |= document
        elif document is not None:
            raise ChecksInvalid(source=str(path), line=1, column=1, reason="it must have FIELD: VALUE, one a line")
    for value in values or ():
        name, equals, content = value.partition("=")
        if not equals or not name:
            raise InvalidInput(what=f"--where {value!r}", reason="write FIELD=VALUE, such as robot=anymal-d")
        try:
            metadata[name] = resolve_plain(content)
        except ValueError:  # a number that is too large
            metadata[name] = content
    return metadata


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
    from kleinkram.checks.outcomes import make_check
    from kleinkram.checks.results import evaluate

    mission: LocalMission = read_mission(files.files, metadata)
    left_out = [make_check("file.incomplete", CheckStatus.not_made, str(error)) for error in files.left_out]
    return evaluate(document, mission, depth, more=left_out)


def exit_code_of(results: "CheckResults", strict: bool) -> int:
    """Return the exit code of `klein check`."""
    if results.verdict is Verdict.unchecked:
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
    shown = [check for check in results.checks if list_all or check.status not in _HIDDEN]
    _show_checks(shown)
    if shown:
        line("")
    line(f"Verdict: {results.verdict.value}{_counts_text(results)}")
    profiles = ", ".join(results.profiles_applied) or "none"
    line(f"Rules:   {source} ({'profile' if len(results.profiles_applied) == 1 else 'profiles'}: {profiles})")
    for profile in results.profiles_left_out:
        line(f"         not applied: {profile.name}, because {profile.reason}")
    if results.verdict is Verdict.unchecked:
        note(_why_unchecked(results))
    passed = results.counts.get(CheckStatus.ok, 0)
    if passed and not list_all:
        note("--all lists the checks that passed.")


def _why_unchecked(results: "CheckResults") -> str:
    if not results.profiles_applied:
        return "Nothing was checked: no profile applies. Name the metadata of the mission with -w FIELD=VALUE."
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


def _show_checks(checks: Sequence[Check]) -> None:
    """Print a line for each check; on a terminal, a long message continues below. Nothing is cut."""
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
            line(text)
            continue
        line(cells.rstrip())
        indent = " " * (widths[0] + 2)
        for part in textwrap.wrap(row[3], max(40, columns - len(indent))):
            line(f"{indent}{part}")


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

    Read it and change it: it is only as good as the missions that it was made from.
    """
    from kleinkram.checks.local import read_mission
    from kleinkram.checks.suggest import suggest_checks

    missions = [read_mission(mission_files([as_contents([path])]).files).facts for path in paths]
    try:
        text = suggest_checks(missions)
    except ValueError as error:
        raise InvalidInput(what="The missions", reason=str(error)) from None
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


app.command("mission")(show_mission_checks)
app.command("matrix")(show_matrix)
app.command("trend")(show_trend)
