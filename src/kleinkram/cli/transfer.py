"""`klein upload`, `klein download` and `klein verify`: options, progress on stderr, and the summary at the end."""

import contextlib
import sys
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import Many, argument, flag, is_json_requested, option, with_option_groups
from kleinkram.cli.errors import EXIT_CODES, ExitCode, Interrupted, exit_code_of
from kleinkram.cli.filters import Choice, select_files
from kleinkram.cli.render import Output, escape, moment, note, table
from kleinkram.cli.units import count, parse_rate, size
from kleinkram.client import Client, connect, transfer
from kleinkram.client.errors import ClientError, InvalidInput, NothingToDo, ServerUnreachable, TimedOut, request_id_of
from kleinkram.client.transfer import (
    Comparison,
    FileComparison,
    SlicePlan,
    SliceRange,
    TransferReport,
    UploadPlan,
    Watcher,
)
from kleinkram.client.transfer.plan import is_excluded, mission_folders
from kleinkram.contract.errors import KleinkramError, NotFound
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.names import is_id
from kleinkram.contract.tokens import is_link

if TYPE_CHECKING:
    from rich.progress import TaskID

    from kleinkram.cli.upload_checks import UploadChecks

_POLL_S = 0.3


@dataclass(frozen=True)
class _UploadOptions:
    create: bool
    metadata_yaml: str | None
    include_active: bool
    exclude: Sequence[str]
    bytes_per_s: float | None
    connections: int
    wait_s: float | None
    dry_run: bool
    checks: "UploadChecks | None" = None


def upload(
    client: Client,
    paths: Annotated[list[str], argument("PATHS", "Files and folders.")],
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    create: Annotated[bool, flag("--create", "Create the mission if there is none.")] = False,
    metadata: Annotated[
        Path | None, option("--metadata", "mission.yaml", "Set the metadata of the new mission.")
    ] = None,
    include_active: Annotated[
        bool, flag("--include-active", "Upload files that are still being recorded, too.")
    ] = False,
    wait: Annotated[bool, flag("--wait", "Wait until the server has read the files.")] = False,
    wait_limit: Annotated[float, option("--wait-limit", "SECONDS", "The maximum time to wait.", min=0)] = 600,
    exclude: options.ExcludeOption = None,
    mission_per_folder: Annotated[
        bool, flag("--mission-per-folder", "Upload each subfolder of PATHS to the mission of its name.")
    ] = False,
    check: Annotated[
        bool, flag("--check", "Check the recordings first, and store the outcome with the mission.")
    ] = False,
    require_good: Annotated[bool, flag("--require-good", "Upload only if the checks say that it is good.")] = False,
    checks: Annotated[
        Path | None,
        option("--checks", "FILE", "The rules for --check; by default those of the project, else checks.yaml."),
    ] = None,
    limit_rate: options.LimitRate = None,
    connections: options.Connections = transfer.CONNECTIONS,
    dry_run: options.DryRun = False,
) -> Output:
    """Upload files and folders to a mission. Running the same command again resumes, and sends only what is missing.

    A folder keeps its tree: `day1` uploads day1/cam.mcap; `day1/` (or `.`) uploads its contents, cam.mcap.
    """
    settings = _UploadOptions(
        create=create,
        metadata_yaml=options.read_text(metadata),
        include_active=include_active,
        exclude=exclude or [],
        bytes_per_s=parse_rate(limit_rate),
        connections=connections,
        wait_s=wait_limit if wait else None,
        dry_run=dry_run,
        checks=_upload_checks(check, require_good, checks),
    )
    if not mission_per_folder:
        document, code = _upload(client, project, options.the_ref("mission", None, mission), paths, settings)
    elif mission is not None:
        raise InvalidInput(what="--mission-per-folder", reason="each folder names its mission: leave out --mission")
    else:
        document, code = _upload_folders(client, options.the_ref("project", None, project), paths, settings)
    return Output(document, exit_code=code)


def _upload_checks(check: bool, require_good: bool, path: Path | None) -> "UploadChecks | None":
    if path is not None and not (check or require_good):
        raise InvalidInput(what="--checks", reason="it needs --check or --require-good")
    if not (check or require_good):
        return None
    from kleinkram.cli.upload_checks import UploadChecks  # only uploads with checks pay for it

    return UploadChecks(path, require_good)


def _upload(
    client: Client, project: str | None, mission: str, paths: Sequence[str], settings: _UploadOptions
) -> tuple[dict[str, object], int]:
    """Upload to one mission; return the JSON result and the exit code."""
    plan = _plan(paths, include_active=settings.include_active, exclude=settings.exclude)
    target: MissionRead | None = None
    try:
        target = client.missions.get(
            mission, project=project if is_id(mission) else options.the_ref("project", None, project)
        )
    except NotFound as error:
        if not settings.create or is_id(mission) or error.resource_type != "mission":
            raise
    checked = None
    if settings.checks is not None:
        checked = settings.checks.run(client, plan, paths[0], project, target, settings.metadata_yaml)
    if settings.dry_run:
        if not is_json_requested():
            rows = [(file.path, size(file.size_bytes), str(file.source)) for file in plan.files]
            table(["path", "size", "from"], rows)
        files = [{"path": file.path, "local": str(file.source), "size_bytes": file.size_bytes} for file in plan.files]
        note(f"Would upload {count(len(plan.files), 'file')}, {size(plan.size_bytes)}.")
        document = {"dry_run": True, "items": files, "left_out": [str(error) for error in plan.left_out]}
        return document | (checked.to_plain() if checked else {}), 0
    if target is None:
        project_id = client.projects.get(project or "").id
        target = client.missions.create(mission, project=project_id, metadata_yaml=settings.metadata_yaml)
        note(f"Created the mission {target.project.name}/{target.name}.")
    elif settings.metadata_yaml is not None:
        note("The mission exists, so --metadata was ignored (`klein mission update` changes it).")
    mission_id = target.id
    report, elapsed_s = run_transfer(
        lambda watcher: transfer.upload(
            client,
            mission_id,
            plan,
            connections=settings.connections,
            bytes_per_s=settings.bytes_per_s,
            watcher=watcher,
        )
    )
    _show_summary(report, elapsed_s)
    code = exit_code_of([*report.failures, *report.left_out])
    if checked is not None:
        checked.store(client, mission_id, report)
    if code == 0 and settings.wait_s is not None:
        _wait_for_summaries(client, mission_id, settings.wait_s)
    document = {"mission_id": str(mission_id), **_plain_report(report, elapsed_s)}
    return document | (checked.to_plain() if checked else {}), code


def _upload_folders(
    client: Client, project: str, paths: Sequence[str], settings: _UploadOptions
) -> tuple[dict[str, object], int]:
    """Upload each subfolder to the mission of its name; one that fails does not stop the others."""
    items: list[dict[str, object]] = []
    codes: set[int] = set()
    for name, folder in mission_folders(paths, settings.exclude).items():
        note(f"{name}:")
        try:
            result, code = _upload(client, project, name, [f"{folder}/"], settings)
        except (Interrupted, ServerUnreachable):
            raise  # the others would fail, too
        except KleinkramError as error:
            result, code = {"error": str(error)}, exit_code_of([error])
            note(f"Error: {error}")
        items.append({"mission": name, **result})
        codes |= {code} if code else set()
    return {"items": items}, 0 if not codes else codes.pop() if len(codes) == 1 else ExitCode.several


def _plan(paths: Sequence[str], *, include_active: bool, exclude: Sequence[str] = ()) -> UploadPlan:
    plan = transfer.plan_upload(paths, include_active=include_active, exclude=exclude)
    _note_left_out(plan.left_out)
    if not plan.files and not plan.left_out:
        raise NothingToDo(reason="There is no file in these paths")
    return plan


def _wait_for_summaries(client: Client, mission_id: uuid.UUID, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while True:
        mission = client.missions.get(mission_id)
        if mission.pending_file_count == 0 and mission.recordings_current:
            return
        if time.monotonic() > deadline:
            raise TimedOut(what=f"Reading {count(mission.pending_file_count, 'file')}", seconds=seconds)
        time.sleep(_POLL_S)


@with_option_groups
def download(
    choice: Choice,
    filters: Annotated[Many, argument("FILTERS", "Paths, globs or ids of files; or the address of a link.")] = None,
    dest: Annotated[Path, option("--dest --output -o", "DIR", "Write to this folder.")] = Path(),
    topics: options.TopicsOption = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    nested: Annotated[bool, flag("--nested", "Write to PROJECT/MISSION/PATH below the folder.")] = False,
    overwrite: options.Overwrite = False,
    exclude: options.ExcludeOption = None,
    limit_rate: options.LimitRate = None,
    connections: options.Connections = transfer.CONNECTIONS,
    dry_run: options.DryRun = False,
) -> Output:
    """Download files, and verify each before it gets its final name. Running the same command again resumes.

    With --topics, --start or --end, a slice of each recording is downloaded as one MCAP instead: only the chunks that
    are needed are fetched. A slice that exists is refused, not resumed. `klein cut` makes one file of several
    recordings.
    """
    bytes_per_s = parse_rate(limit_rate)
    links = [value for value in filters or [] if is_link(value)]
    refs = [value for value in filters or [] if not is_link(value)]
    if len(links) > 1:
        raise InvalidInput(what="The command", reason="specify one link at a time")
    if choice.is_empty() and not filters:
        raise InvalidInput(what="The command", reason="specify files: -p, -m, a path, a glob ('*' for all) or an id")
    with connect(*links) as client:
        files = [file for file in select_files(client, choice, refs) if not is_excluded(file.path, exclude or [])]
        if (topics, start, end) != (None, None, None):
            if bytes_per_s is not None:
                raise InvalidInput(what="--limit-rate", reason="it does not limit slices of recordings")
            what = transfer.SliceRange(options.topic_names(topics), start, end)
            return _download_slices(
                client,
                transfer.plan_slices(client, files, dest, nested=nested),
                what,
                overwrite=overwrite,
                dry_run=dry_run,
            )
        plan = transfer.plan_download(files, dest, nested=nested)
        _note_left_out(plan.left_out)
        if not plan.targets and not plan.left_out:
            raise NothingToDo(reason="No file matches")
        if dry_run:
            rows = [(target.file.path, str(target.local), target.file.size_bytes) for target in plan.targets]
            items = [{"path": path, "local": local, "size_bytes": size_bytes} for path, local, size_bytes in rows]
            cells = [(path, size(size_bytes), local) for path, local, size_bytes in rows]
            note(f"Would download {count(len(plan.targets), 'file')}, {size(plan.size_bytes)}.")
            document = {"dry_run": True, "items": items, "left_out": [str(error) for error in plan.left_out]}
            return Output(document, lambda: table(["path", "size", "to"], cells))
        report, elapsed_s = run_transfer(
            lambda watcher: transfer.download(
                client, plan, overwrite=overwrite, connections=connections, bytes_per_s=bytes_per_s, watcher=watcher
            )
        )
    return transfer_output(report, elapsed_s)


def _download_slices(client: Client, plan: SlicePlan, what: SliceRange, *, overwrite: bool, dry_run: bool) -> Output:
    """Download a slice of each recording."""
    _note_left_out(plan.left_out)
    if not plan.targets and not plan.left_out:
        raise NothingToDo(reason="No recording matches")
    if dry_run:
        _, targets = transfer.select_targets(plan, what)
        rows = [(target.name, str(target.dest / target.relative)) for target in targets]
        note(f"Would read {count(len(rows), 'recording')}.")
        items = [{"recording": name, "local": local} for name, local in rows]
        document = {"dry_run": True, "items": items, "left_out": [str(error) for error in plan.left_out]}
        return Output(document, lambda: table(["recording", "to"], rows))
    report, elapsed_s = run_transfer(
        lambda watcher: transfer.download_slices(client, plan, what, overwrite=overwrite, watcher=watcher)
    )
    _note_left_out(report.left_out[len(plan.left_out) :])
    return transfer_output(report, elapsed_s)


def verify(
    client: Client,
    paths: Annotated[Many, argument("PATHS", "Local files and folders.")] = None,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    remote: Annotated[
        bool, flag("--remote", "Have the server read its stored bytes; PATHS are then paths in the mission.")
    ] = False,
    timeout: Annotated[float, option("--timeout", "SECONDS", "The maximum time to wait for the server.")] = 600.0,
) -> Output:
    """Compare local files with those of a mission by SHA-256, or verify the stored bytes with --remote."""
    left_out: Sequence[ClientError] = ()
    if remote:
        choice = Choice(project=project, mission=mission)
        if choice.is_empty() and not paths:
            raise InvalidInput(what="The command", reason="specify files: -p, -m, a path, a glob or an id")
        files = select_files(client, choice, paths or [])
        if not files:
            raise NothingToDo(reason="No file matches")
        comparisons = transfer.verify_remote(client.files, files, timeout_s=timeout)
    else:
        if not paths:
            raise InvalidInput(what="The command", reason="specify local files to compare, or --remote")
        plan = _plan(paths, include_active=True)
        ref = options.the_ref("mission", None, options.the_only("mission", mission))
        mission_id = client.missions.get(ref, project=options.the_only("project", project)).id
        comparisons, left_out = transfer.verify_local(client.files, mission_id, plan), plan.left_out
    unread = [one.error for one in comparisons if one.error is not None]
    _note_left_out(unread)
    same_count = sum(one.comparison is Comparison.same for one in comparisons)
    note(f"{same_count} of {count(len(comparisons) + len(left_out), 'file')} are the same.")
    exit_code = exit_code_of([*unread, *left_out])
    if len(comparisons) - same_count > len(unread):
        exit_code = ExitCode.bytes_differ
    items = [_plain_comparison(one) for one in comparisons]
    document = {"items": items, "left_out": [_plain_error(error) for error in left_out]}
    return Output(document, lambda: _show_comparisons(comparisons), exit_code)


def _show_comparisons(comparisons: list[FileComparison]) -> None:
    named = _named(comparisons)
    table(["result", "path", "size"], [(one.comparison.value, path, size(one.size_bytes)) for one, path in named])
    for one, path in named:
        if one.file is not None and one.file.damaged_at is not None:
            reason, since = one.file.state_reason, moment(one.file.damaged_at)
            note(f"{path} is {one.file.state.value} since {since}: {reason}. Upload it again to repair it.")


def _named(comparisons: list[FileComparison]) -> list[tuple[FileComparison, str]]:
    """Return each comparison with its path, preceded by project and mission where there are several missions."""
    locations = [(one.file.mission.project.name, one.file.mission.name) if one.file else () for one in comparisons]
    if len({location for location in locations if location}) < 2:
        return [(one, one.path) for one in comparisons]
    return [(one, "/".join([*location, one.path])) for one, location in zip(comparisons, locations, strict=True)]


def _plain_comparison(one: FileComparison) -> dict[str, object]:
    file = one.file
    return {
        "path": one.path,
        "result": one.comparison.value,
        "size_bytes": one.size_bytes,
        "sha256": one.sha256,
        "file_id": str(file.id) if file else None,
        "state": file.state.value if file else None,
        "state_reason": file.state_reason if file else None,
        "damaged_at": file.damaged_at.isoformat() if file and file.damaged_at else None,
    }


def _note_left_out(left_out: Iterable[ClientError]) -> None:
    for error in left_out:
        note(str(error))


def run_transfer(start: Callable[[Watcher], TransferReport]) -> tuple[TransferReport, float]:
    """Run a transfer with progress on stderr; return its report and its seconds. Ctrl-C raises Interrupted."""
    began_at = time.monotonic()
    try:
        with watching() as watcher:
            report = start(watcher)
    except KeyboardInterrupt:
        raise Interrupted from None
    return report, time.monotonic() - began_at


def transfer_output(report: TransferReport, elapsed_s: float) -> Output:
    """Print the summary of a transfer; return its report and exit code."""
    _show_summary(report, elapsed_s)
    return Output(_plain_report(report, elapsed_s), exit_code=exit_code_of([*report.failures, *report.left_out]))


def _plain_report(report: TransferReport, elapsed_s: float) -> dict[str, object]:
    items = [
        {
            "path": result.path,
            "local": str(result.local),
            "size_bytes": result.size_bytes,
            "outcome": result.outcome.value,
            "moved_bytes": result.moved_bytes,
            "file_id": str(result.file_id) if result.file_id else None,
            "sha256": result.sha256,
            "error": _plain_error(result.error) if result.error else None,
            **({"losses": [*result.losses]} if result.losses else {}),
        }
        for result in report.results
    ]
    left_out = [_plain_error(error) for error in report.left_out]
    return {"elapsed_s": elapsed_s, "items": items, "left_out": left_out, "link": asdict(report.link)}


def _plain_error(error: KleinkramError) -> dict[str, object]:
    return {"kind": type(error).__name__, "message": str(error), "exit_code": int(EXIT_CODES[type(error)])}


def _show_summary(report: TransferReport, elapsed_s: float) -> None:
    moved = sum(result.moved_bytes for result in report.results)
    counts = Counter(result.outcome.value for result in report.results)
    outcomes = ", ".join(f"{number} {outcome}" for outcome, number in sorted(counts.items())) or "nothing"
    speed = f", {size(int(moved / elapsed_s))}/s" if moved and elapsed_s > 0 else ""
    note(f"{outcomes}; {size(moved)} in {elapsed_s:.1f} s{speed}")
    if (advice := report.link.advice()) is not None:
        note(advice)
    for request_id in sorted({known for error in report.failures if (known := request_id_of(error))}):
        note(f"Request id: {request_id}")


@contextlib.contextmanager
def watching() -> Iterator[Watcher]:
    """Show the progress of a transfer on stderr: bars on a terminal, else one line per file."""
    if not sys.stderr.isatty():
        yield FileLines()
        return
    bars = ProgressBars()
    with bars.progress:
        yield bars


class FileLines(Watcher):
    """Prints one line per file."""

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """Print how a file ended."""
        note(f"{outcome:<10} {path}" + (f": {reason}" if reason else ""))

    def notify(self, text: str) -> None:
        """Print a message."""
        note(text)


class ProgressBars(Watcher):
    """Shows a bar for all files and one for each file in transfer, with rate and time left."""

    def __init__(self) -> None:
        from rich import progress
        from rich.console import Console

        self.progress = progress.Progress(
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            progress.DownloadColumn(),
            progress.TransferSpeedColumn(),
            progress.TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._lock = threading.Lock()
        self._total: TaskID | None = None
        self._files: dict[str, TaskID] = {}

    def began(self, files: int, size_bytes: int) -> None:
        """Show the bar for all files."""
        self._total = self.progress.add_task(count(files, "file"), total=size_bytes)

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Advance the bars."""
        self.skipped(path, size_bytes, total_bytes)

    def skipped(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Advance the bars."""
        with self._lock:
            if path not in self._files:
                from rich.markup import escape as escape_markup

                self._files[path] = self.progress.add_task(escape_markup(escape(path)), total=total_bytes)
            self.progress.advance(self._files[path], size_bytes)
            if self._total is not None:
                self.progress.advance(self._total, size_bytes)

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """Remove the bar of a file, and print why it failed."""
        with self._lock:
            if (task := self._files.pop(path, None)) is not None:
                self.progress.remove_task(task)
        if reason:
            self.notify(f"{outcome} {path}: {reason}")

    def notify(self, text: str) -> None:
        """Print above the bars."""
        self.progress.console.print(escape(text), markup=False, highlight=False)
