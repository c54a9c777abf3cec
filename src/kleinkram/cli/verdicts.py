"""The checks and verdicts of missions on a server: `klein checks mission|matrix|trend`, `klein mission accept|note`."""

from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import Text, argument, flag, option
from kleinkram.cli.render import Output, details, line, note, table
from kleinkram.cli.units import count, instant
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.checks import (
    CellStatus,
    CheckAcceptanceRead,
    CheckMatrix,
    CheckNoteRead,
    CheckStatus,
    CheckTrend,
    MissionCheck,
    MissionChecksRead,
    TrendStep,
    Verdict,
)
from kleinkram.contract.errors import NotFound
from kleinkram.contract.missions import MissionRead

NameArgument = Annotated[
    Text, argument("MISSION", "Name or id of the mission.", autocompletion=options.complete_mission)
]
ProjectArgument = Annotated[
    Text, argument("PROJECT", "Name or id of the project.", autocompletion=options.complete_project)
]
CheckOption = Annotated[Text, option("--check", "NAME", "The check, such as topic.gap.")]
TopicOption = Annotated[Text, option("--topic -t", "TOPIC", "The topic of the check; by default all topics.")]
AcceptedTopicOption = Annotated[
    Text, option("--topic -t", "TOPIC", "The topic of the check; by default all topics on which it fails now.")
]
_STATUSES = {status.value: status.value.replace("_", " ") for status in CellStatus}


def show_mission_checks(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    all_: Annotated[
        bool, flag("--all", "List the checks that passed, too, and acceptances and reports that no longer count.")
    ] = False,
    check: Annotated[Text, option("--check", "NAME", "Only the checks of this name, which may be a glob.")] = None,
    status: Annotated[list[CheckStatus] | None, option("--status", None, "Select by status; repeatable.")] = None,
) -> Output:
    """Show the verdict of a mission, and the checks that failed."""
    target = client.missions.get(options.the_ref("mission", name, mission), project=project)
    result = client.checks.mission(target.id, history=all_, name=check, status=status or ())
    return Output(result, lambda: _show_checks(target, result, list_all=all_ or bool(status)))


def show_matrix(
    client: Client,
    name: ProjectArgument = None,
    project: options.ProjectOption = None,
    limit: Annotated[int, option("--limit", "N", "Show at most N missions.")] = 100,
) -> Output:
    """Show the missions of a project, latest first, with the worst status of each check."""
    target = client.projects.get(options.the_ref("project", name, project))
    if limit < 1:
        raise InvalidInput(what="--limit", reason="it is at least 1")
    matrix = client.checks.matrix(target.id, limit=limit)
    return Output(matrix, lambda: _show_matrix(matrix))


def show_trend(
    client: Client,
    name: ProjectArgument = None,
    project: options.ProjectOption = None,
    by: Annotated[TrendStep, option("--by", None, "Count by day or week.")] = TrendStep.week,
) -> Output:
    """Count the missions of a project by verdict, by the day or week in which they were recorded."""
    target = client.projects.get(options.the_ref("project", name, project))
    trend = client.checks.trend(target.id, by=by)
    return Output(trend, lambda: _show_trend(trend))


def accept(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    check: CheckOption = None,
    topic: AcceptedTopicOption = None,
    because: Annotated[Text, option("--because", "TEXT", "The reason, for others, also those with a link.")] = None,
    withdraw: Annotated[bool, flag("--withdraw", "Withdraw the acceptance: the check counts again.")] = False,
) -> Output:
    """Accept what fails of a check of a mission: it no longer counts, until the files change. New failures count."""
    if check is None or (because is None) != withdraw:
        raise InvalidInput(what="The command", reason="specify --check, and either --because or --withdraw")
    target = client.missions.get(options.the_ref("mission", name, mission), project=project)
    if because is not None:
        made = client.checks.accept(target.id, check, because=because, topic=topic)
        covered = f"{count(made.failure_count, 'failure')} of {_check_of(made)} in {target.name}"
        verb = "counts" if made.failure_count == 1 else "count"
        return Output(made, f"{covered} no longer {verb}, until its files change.")
    current = client.checks.mission(target.id).acceptances
    accepted = next((one for one in current if (one.check, one.topic) == (check, topic)), None)
    if accepted is None:
        raise NotFound(resource_type="acceptance", ref=check if topic is None else f"{check} on {topic}")
    ended = client.checks.withdraw(target.id, accepted.id)
    return Output(ended, f"{_check_of(ended)} of {target.name} counts again.")


def add_note(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    check: CheckOption = None,
    topic: TopicOption = None,
    text: Annotated[Text, option("--text", "TEXT", "The note.")] = None,
) -> Output:
    """Add a note to a check of a mission."""
    if check is None or text is None:
        raise InvalidInput(what="The command", reason="specify --check and --text")
    target = client.missions.get(options.the_ref("mission", name, mission), project=project)
    made = client.checks.add_note(target.id, check, text, topic=topic)
    return Output(made, f"Noted on {check} of {target.name}.")


def verdict_text(mission: MissionRead) -> str:
    """Return the verdict of a mission with the number of checks that failed, such as `bad (2 errors)`."""
    counts = mission.checks
    numbers = [(counts.error, "error"), (counts.warning, "warning"), (counts.not_made, "not made")]
    texts = [f"{number} {noun}{'s' if number > 1 and noun != 'not made' else ''}" for number, noun in numbers if number]
    texts += [f"{counts.accepted} accepted"] if counts.accepted else []
    return f"{mission.verdict.value} ({', '.join(texts)})" if texts else mission.verdict.value


def _show_checks(mission: MissionRead, result: MissionChecksRead, *, list_all: bool) -> None:
    details(
        [
            ("mission", f"{mission.project.name}/{mission.name}"),
            ("verdict", verdict_text(mission.model_copy(update={"verdict": result.verdict, "checks": result.counts}))),
            ("bad since", result.bad_since),
            ("evaluated", result.evaluated_at),
            ("rules", f"version {result.checks_number}" if result.checks_number else None),
            ("profiles", ", ".join(result.profiles_applied) or None),
            *((f"not {one.name}", one.reason) for one in result.profiles_left_out),
            ("reference", result.reference),
        ]
    )
    failed = (CheckStatus.error, CheckStatus.warning, CheckStatus.not_made)
    shown = [check for check in result.checks if list_all or check.status in failed]
    if shown:
        line("")
        table(["status", "check", "where", "message", "source"], map(_cells, shown))
    if result.acceptances:
        line("")
        table(["accepted", "failures", "by", "because", "ended"], map(_acceptance_cells, result.acceptances))
    if result.notes:
        line("")
        table(["note on", "by", "text"], [(_check_of(one), one.created_by.name, one.text) for one in result.notes])
    if not any(result.counts.model_dump().values()) or result.verdict is Verdict.unchecked:
        note(_why_unchecked(result))


def _cells(check: MissionCheck) -> tuple[object, ...]:
    status = _STATUSES[check.status.value] + (" (accepted)" if check.acceptance_id else "")
    return status, check.name, check.topic or check.file, check.message, check.action or check.source.value


def _acceptance_cells(one: CheckAcceptanceRead) -> tuple[object, ...]:
    ended = one.ended.value.replace("_", " ") if one.ended else None
    return _check_of(one), one.failure_count, one.created_by.name if one.created_by else None, one.because, ended


def _why_unchecked(result: MissionChecksRead) -> str:
    if result.verdict is Verdict.running:
        return "The checks are being made."
    if result.counts.needs_content:
        return "Checks of the messages are still to be made: by `klein upload --check`, or an action of the project."
    if result.profiles_left_out:
        return "No profile of the project's checks.yaml applies to this mission."
    return "Nothing was checked; `klein checks set` sets the rules of a project."


def _show_matrix(matrix: CheckMatrix) -> None:
    rows = [
        (
            row.mission.name,
            row.verdict.value,
            instant(row.start_ns),
            *(_STATUSES[row.cells[name].value] if name in row.cells else None for name in matrix.checks),
        )
        for row in matrix.items
    ]
    table(["mission", "verdict", "start", *matrix.checks], rows)


def _show_trend(trend: CheckTrend) -> None:
    verdicts = [verdict for verdict in Verdict if any(verdict in bucket.verdicts for bucket in trend.buckets)]
    rows = [(bucket.start, *(bucket.verdicts.get(verdict) for verdict in verdicts)) for bucket in trend.buckets]
    table([trend.by.value, *(verdict.value for verdict in verdicts)], rows)


def _check_of(one: CheckAcceptanceRead | CheckNoteRead) -> str:
    return one.check if one.topic is None else f"{one.check} on {one.topic}"
