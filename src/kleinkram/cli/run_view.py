"""The display of runs: tables, details, logs without control characters, and following a run on stderr."""

import contextlib
import re
import sys
import threading
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, TextIO

import typer

from kleinkram.cli.errors import ExitCode
from kleinkram.cli.render import details, escape, line, note, table
from kleinkram.cli.units import count, duration, instant, size
from kleinkram.client import Client
from kleinkram.contract.checks import Check, CheckStatus, Verdict
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.reports import Finding, Metric, Severity
from kleinkram.contract.runs import ActionRef, RunDetail, RunPriority, RunRead, RunState

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status

_NS = 10**9
# Whole numbers of a double are exact below.
_WHOLE_BELOW = 2**53
_VERDICT_TEXTS = {
    Verdict.warnings: "The run is done. It says of the mission {mission}: warnings.",
    Verdict.bad: "The run is done. It says that the mission {mission} is bad.",
}
_STATUS_TEXTS = {status: status.value.replace("_", " ") for status in CheckStatus}
_REST_OF_LOG_S = 30.0  # the maximum time to wait for the rest of the log of a run that has ended
# Source: ECMA-48, section 8.3.117, SGR: colours and weights of letters.
_COLOUR = re.compile(r"(\x1b\[[0-9;]*m)")
_PLAIN = "\x1b[0m"


def action_name(action: ActionRef) -> str:
    """Return an action with its version, as `klein action run` takes it."""
    return action.name if action.version is None else f"{action.name}@{action.version}"


def mission_name(run: RunRead) -> str:
    """Return a run's mission with its project."""
    return f"{run.mission.project.name}/{run.mission.name}"


def status_text(run: RunRead) -> str:
    """Return the state of a run with its progress, its reason, or its verdict where that is not good."""
    if run.state is RunState.queued:
        return f"{_queued(run)}: {run.waits_for}" if run.waits_for else _queued(run)
    if run.state is RunState.failed and run.reason is not None:
        return f"failed: {run.reason.value}" + ("" if run.exit_code is None else f" {run.exit_code}")
    if run.state is RunState.done:
        verdict = "" if run.verdict in {None, Verdict.good} else f": {run.verdict.value}"
        return f"done{verdict}" + (" (reused)" if run.reuses_id is not None else "")
    if run.state is RunState.running and run.progress is not None:
        return f"running {run.progress.fraction:.0%} {run.progress.message}".rstrip()
    if run.state in {RunState.preparing, RunState.collecting} and run.progress is not None and run.progress.message:
        return f"{run.state.value}: {run.progress.message}"
    return str(run.state.value)


def _queued(run: RunRead) -> str:
    return "queued" if run.priority is RunPriority.normal else f"queued ({run.priority.value} priority)"


def _short_status(run: RunRead) -> str:
    if run.state is RunState.queued:
        return _queued(run)
    return run.state.value if run.state is RunState.collecting else status_text(run)


def show_runs(runs: Iterable[RunRead]) -> None:
    """Print runs of any missions as a table, and why queued ones wait."""
    rows = [*runs]
    are_placed = any(_place(run) for run in rows)
    table(
        [
            *("project", "mission", "action", "state", "took", "findings", "metrics", "artifacts"),
            *(["where"] if are_placed else []),
            *("made", "by", "run"),
        ],
        [
            (
                run.mission.project.name,
                run.mission.name,
                action_name(run.action),
                _short_status(run),
                _took(run),
                *_counts(run),
                *([_place(run)] if are_placed else []),
                run.created_at,
                run.cause.person and run.cause.person.name,
                run.id,
            )
            for run in rows
        ],
    )
    for why in dict.fromkeys(run.waits_for for run in rows if run.waits_for):
        note(f"queued: {why}")


def show_run(run: RunDetail) -> None:
    """Print everything about a run but its log, metrics and findings."""
    usage = run.usage
    person = f" by {run.cause.person.name}" if run.cause.person else ""
    _, metrics, artifacts = _counts(run)
    checks = ", ".join(f"{number} {_STATUS_TEXTS[status]}" for status, number in run.check_counts.items())
    details(
        [
            ("run", run.id),
            ("action", action_name(run.action)),
            ("mission", mission_name(run)),
            ("state", status_text(run)),
            ("priority", None if run.priority is RunPriority.normal else run.priority.value),
            ("message", run.message),
            ("results of", run.reuses_id),
            ("retry of", run.cause.retry_of_id),
            ("recorded", "it was executed elsewhere" if run.is_recorded else None),
            ("made", f"{run.created_at:%Y-%m-%d %H:%M:%S}Z{person}"),
            ("started", run.started_at),
            ("ended", run.ended_at),
            ("took", _took(run)),
            ("attempt", run.attempt if run.attempt > 1 else None),
            ("runner", run.runner),
            ("isolation", run.isolation and run.isolation.value),
            *_placement_rows(run),
            ("image", run.image_digest),
            ("network", run.network.value),
            ("inputs", f"{count(run.input_count, 'file')}, {size(run.input_bytes)}"),
            *((f"  {name}", value) for name, value in run.parameters.items()),
            ("used", usage and f"{usage.cpu_s:.1f} s of cores, {size(usage.peak_memory_bytes)} of memory at most"),
            ("artifacts", artifacts),
            ("metrics", metrics),
            ("verdict", run.verdict and run.verdict.value),
            ("checks", checks),
            ("findings", _findings_text(run)),
            *((f"proposed {name}", value) for name, value in run.metadata.items()),
            *(("problem", problem) for problem in run.problems),
        ]
    )


def _place(run: RunRead) -> str | None:
    """Return the node and the job of a run on a cluster."""
    placement = run.placement
    if placement is None:
        return None
    job = None if placement.job_id is None else f"job {placement.job_id}"
    return ", ".join(part for part in (placement.node, job) if part) or None


def _placement_rows(run: RunRead) -> list[tuple[str, object]]:
    """Return where a run is on its cluster or machine, and what that measured."""
    placement = run.placement
    if placement is None:
        return []
    used = []
    if placement.cpu_s is not None:
        used.append(f"{placement.cpu_s:.1f} s of cores")
    if placement.peak_memory_bytes is not None:
        used.append(f"{size(placement.peak_memory_bytes)} of memory at most")
    return [
        ("node", placement.node),
        ("job", placement.job_id),
        ("queue wait", None if placement.queued_s is None else duration(int(placement.queued_s * _NS))),
        ("requeued", count(placement.requeues, "time") if placement.requeues else None),
        ("GPUs", ", ".join(f"GPU {gpu}" if gpu.isdecimal() else gpu for gpu in placement.gpus)),
        ("accounted", ", ".join(used)),
    ]


def show_results(checks: Sequence[Check], metrics: Sequence[Metric], findings: Sequence[Finding]) -> None:
    """Print the checks, metrics and findings of one run, an empty line before each table."""
    if checks:
        line("")
        show_checks(checks)
    if metrics:
        line("")
        show_metrics(metrics)
    if findings:
        line("")
        show_findings(findings)


def show_checks(checks: Iterable[Check]) -> None:
    """Print the checks of one run as a table."""
    table(
        ["check", "status", "message", "value", "limit", "unit", "topic", "file", "time"],
        [
            (
                *(entry.name, _STATUS_TEXTS[entry.status], entry.message),
                *(number_text(entry.value), number_text(entry.limit), entry.unit),
                *(entry.topic, entry.file, instant(entry.time_ns)),
            )
            for entry in checks
        ],
    )


def show_metrics(metrics: Iterable[Metric]) -> None:
    """Print the metrics of one run as a table."""
    table(
        ["metric", "value", "unit", "topic", "labels", "file"],
        [
            (entry.name, number_text(entry.value), entry.unit, entry.topic, labels_text(entry.labels), entry.file)
            for entry in metrics
        ],
    )


def number_text(value: float | None) -> str | None:
    """Return a number with six digits, whole numbers with all of theirs."""
    if value is None:
        return None
    return f"{value:.0f}" if value.is_integer() and abs(value) < _WHOLE_BELOW else f"{value:.6g}"


def labels_text(labels: Mapping[str, object]) -> str | None:
    """Return names and values, such as `method=kiss-icp`; None for none."""
    return ", ".join(f"{name}={value}" for name, value in labels.items()) or None


def _findings_text(run: RunRead) -> str:
    """Return the number of findings by severity, the worst first."""
    counts = [(severity, run.finding_counts.get(severity, 0)) for severity in reversed(Severity)]
    return ", ".join(f"{number} {severity.value}" for severity, number in counts if number)


def show_findings(findings: Iterable[Finding]) -> None:
    """Print the findings of one run as a table."""
    table(
        ["severity", "finding", "message", "file", "topic", "time"],
        [
            (entry.severity.value, entry.code, entry.message, entry.file, entry.topic, instant(entry.time_ns))
            for entry in findings
        ],
    )


def _counts(run: RunRead) -> tuple[str | None, int | None, int | None]:
    """Return the counts of findings, metrics and artifacts; none for a run that reuses the results of another."""
    if run.reuses_id is not None:
        return None, None, None
    return _findings_text(run) or "0", run.metric_count, run.artifact_count


def _took(run: RunRead) -> str | None:
    if run.started_at is None or run.ended_at is None:
        return None
    return duration(int((run.ended_at - run.started_at).total_seconds() * _NS))


def harmless(text: str) -> str:
    """Return text with all control characters escaped but line feeds, tabs and colours, which end with each line.

    A progress bar that redraws itself after carriage returns becomes its last state.
    """
    lines = []
    for written in text.split("\n"):
        parts = _COLOUR.split(written.rstrip("\r").rpartition("\r")[2])
        shown = "".join(part if at % 2 else "\t".join(map(escape, part.split("\t"))) for at, part in enumerate(parts))
        lines.append(shown + _PLAIN if len(parts) > 1 else shown)
    return "\n".join(lines)


def write_log(text: str, stream: TextIO) -> None:
    """Write the output of a run: escaped to a terminal, unchanged to a file or pipe."""
    stream.write(harmless(text) if stream.isatty() else text)
    stream.flush()


class RunView:
    """Shows a run on stderr while it lasts: its log, and its state in a line below, or a line at each change."""

    def __init__(self, console: "Console | None" = None, status: "Status | None" = None) -> None:
        self._console = console
        self._status = status
        self._last = ""

    def show_state(self, run: RunDetail) -> None:
        """Show the current state."""
        where = f" on {run.runner}" if run.runner and run.state is not RunState.queued else ""
        if self._status is not None:
            from rich.markup import escape as escape_markup

            self._status.update(escape_markup(escape(status_text(run) + where)))
            return
        now = run.state.value if run.state is RunState.running else status_text(run)
        if now != self._last and run.ended_at is None:
            note(now + where)
        self._last = now

    def show_log(self, text: str) -> None:
        """Show more of the log."""
        if self._console is None:
            write_log(text, sys.stderr)
            return
        from rich.text import Text

        self._console.print(Text.from_ansi(harmless(text.removesuffix("\n"))), soft_wrap=True)


def follow(client: Client, run_id: uuid.UUID) -> RunDetail:
    """Show a run until it ends, and how it ended; Ctrl-C ends the command with exit code 130, and not the run."""
    try:
        with _viewing() as view:
            run = _follow(client, run_id, view)
    except KeyboardInterrupt:
        note(f"The run continues. `klein run logs -f {run_id}` follows it again, `klein run cancel {run_id}` ends it.")
        raise typer.Exit(ExitCode.interrupted) from None
    for problem in run.problems:
        note(problem)
    if run.reuses_id is not None:
        note(f"These are the results of run {run.reuses_id}: same version, parameters, inputs. --force runs it again.")
    if run.verdict in {Verdict.warnings, Verdict.bad}:
        note(_VERDICT_TEXTS[run.verdict].format(mission=mission_name(run)))
    if run.state is not RunState.done:
        note(f"{run.state.value}: {run.message}" if run.message else run.state.value)
    return run


def _follow(client: Client, run_id: uuid.UUID, view: RunView) -> RunDetail:
    failures: list[KleinkramError] = []

    def show_log() -> None:
        attempt = 0
        try:
            for piece in client.runs.log(run_id, follow=True):
                if attempt and piece.attempt != attempt:
                    note(f"Its runner was lost: attempt {piece.attempt} starts from the beginning.")
                attempt = piece.attempt
                view.show_log(piece.text)
        except KleinkramError as error:
            failures.append(error)

    # A daemon thread, because Ctrl-C may interrupt a request that is waiting.
    log = threading.Thread(target=show_log, daemon=True)
    log.start()
    run = client.runs.wait(run_id, seen=view.show_state)
    log.join(timeout=_REST_OF_LOG_S)
    for failure in failures:
        raise failure
    return run


@contextlib.contextmanager
def _viewing() -> Iterator[RunView]:
    if not sys.stderr.isatty():
        yield RunView()
        return
    from rich.console import Console

    console = Console(stderr=True)
    with console.status("connecting") as status:
        yield RunView(console, status)
