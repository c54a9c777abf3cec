"""How runs look: in lists, one by one, and what they said."""

from collections.abc import Iterable, Sequence

from kleinkram.cli.render import details, line, note, table
from kleinkram.cli.units import count, duration, instant, size
from kleinkram.contract.reports import Finding, Metric
from kleinkram.contract.runs import ActionRef, FindingRead, MetricRead, RunDetail, RunRead, RunState

_NS = 10**9


def action_name(action: ActionRef) -> str:
    """Return an action with its version, as `klein action run` takes it."""
    return action.name if action.version is None else f"{action.name}@{action.version}"


def mission_name(run: RunRead) -> str:
    """Return a run's mission with its project."""
    return f"{run.mission.project.name}/{run.mission.name}"


def standing(run: RunRead) -> str:
    """Return what a run is at, or how it ended, in a few words."""
    if run.state is RunState.queued:
        return f"queued: {run.waits_for}" if run.waits_for else "queued"
    if run.state is RunState.failed and run.reason is not None:
        return f"failed: {run.reason.value}" + ("" if run.exit_code is None else f" {run.exit_code}")
    if run.state is RunState.done and run.reuses_id is not None:
        return "done: reused"
    if run.state is RunState.running and run.progress is not None:
        return f"running {run.progress.fraction:.0%} {run.progress.message}".rstrip()
    if run.state is RunState.collecting and run.progress is not None and run.progress.message:
        return f"collecting: {run.progress.message}"
    return str(run.state.value)


def show_runs(runs: Iterable[RunRead]) -> None:
    """Print runs of any missions as a table, and why those that wait do."""
    rows = [*runs]
    table(
        ["project", "mission", "action", "state", "took", "findings", "metrics", "artifacts", "made", "by", "run"],
        [
            (
                run.mission.project.name,
                run.mission.name,
                action_name(run.action),
                _short(run),
                _took(run),
                *_counts(run),
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
    """Print all that is known of a run but for its log and what it said."""
    usage = run.usage
    details(
        [
            ("run", run.id),
            ("action", action_name(run.action)),
            ("mission", mission_name(run)),
            ("state", standing(run)),
            ("told", run.message),
            ("results of", run.reuses_id),
            ("retry of", run.cause.retry_of_id),
            (
                "made",
                f"{run.created_at:%Y-%m-%d %H:%M:%S}Z" + (f" by {run.cause.person.name}" if run.cause.person else ""),
            ),
            ("started", run.started_at),
            ("ended", run.ended_at),
            ("took", _took(run)),
            ("attempt", run.attempt if run.attempt > 1 else None),
            ("runner", run.runner),
            ("image", run.image_digest),
            ("network", run.network.value),
            ("inputs", f"{count(run.input_count, 'file')}, {size(run.input_bytes)}"),
            *((f"  {name}", value) for name, value in run.parameters.items()),
            ("used", usage and f"{usage.cpu_s:.1f} s of cores, {size(usage.peak_memory_bytes)} of memory at most"),
            ("artifacts", _counts(run)[2]),
            ("metrics", _counts(run)[1]),
            ("findings", ", ".join(f"{count} {severity.value}" for severity, count in run.finding_counts.items())),
            *((f"proposed {name}", value) for name, value in run.metadata.items()),
            *(("problem", problem) for problem in run.problems),
        ]
    )


def show_results(metrics: Sequence[MetricRead], findings: Sequence[FindingRead]) -> None:
    """Print what one run said."""
    if metrics:
        line("")
        show_metrics([entry.metric for entry in metrics])
    if findings:
        line("")
        show_findings([entry.finding for entry in findings])


def show_metrics(metrics: Iterable[Metric]) -> None:
    """Print the metrics of one run as a table."""
    table(["metric", "value", "unit", "file"], [(entry.name, entry.value, entry.unit, entry.file) for entry in metrics])


def show_findings(findings: Iterable[Finding]) -> None:
    """Print the findings of one run as a table."""
    table(
        ["severity", "finding", "message", "file", "topic", "time"],
        [
            (entry.severity.value, entry.code, entry.message, entry.file, entry.topic, instant(entry.time_ns))
            for entry in findings
        ],
    )


def _short(run: RunRead) -> str:
    return str(run.state.value) if run.state in {RunState.queued, RunState.collecting} else standing(run)


def _counts(run: RunRead) -> tuple[int | None, int | None, int | None]:
    """Return how many findings, metrics and artifacts a run has; a run that reuses another's has that one's."""
    if run.reuses_id is not None:
        return None, None, None
    return sum(run.finding_counts.values()), run.metric_count, run.artifact_count


def _took(run: RunRead) -> str | None:
    if run.started_at is None or run.ended_at is None:
        return None
    return duration(int((run.ended_at - run.started_at).total_seconds() * _NS))
