"""`klein cut --event`: what was recorded around events of missions, as one MCAP each."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kleinkram.cli.filters import filter_of, ids_of
from kleinkram.cli.render import Output, note, table
from kleinkram.cli.transfer import run_transfer, transfer_output
from kleinkram.cli.units import count, duration, instant
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.transfer.event_slices import EventSlicePlan, cut_event_slices, plan_event_slices
from kleinkram.contract.mission_events import MissionEventFilter
from kleinkram.contract.units import read_duration
from kleinkram.recordings import McapOptions

_MAX_AROUND_NS = 86_400 * 10**9


@dataclass(frozen=True)
class EventChoice:
    """Which events are cut, and how much around them: `names` may be globs."""

    names: Sequence[str]
    around: str
    project: str | None
    mission: str | None


def cut_around_events(
    client: Client,
    choice: EventChoice,
    dest: Path,
    *,
    topics: Sequence[str] | None,
    how: McapOptions,
    dry_run: bool,
) -> Output:
    """Write one MCAP for each event; with `dry_run`, only list them."""
    if choice.project is None and choice.mission is None:
        raise InvalidInput(what="--event", reason="it selects events of a mission, -m, or of a project, -p")
    around_ns = _around_ns(choice.around)
    where = ids_of(client, choice.project and [choice.project], choice.mission and [choice.mission])
    events = client.mission_events.list(filter_of(MissionEventFilter, {"name": [*choice.names], **where}))
    plan = plan_event_slices(events, dest, around_ns=around_ns)
    if not plan.slices and not plan.left_out:
        raise NothingToDo(reason=f"There is no event {', '.join(choice.names)}")
    if dry_run:
        return _planned(plan)
    report, elapsed_s = run_transfer(
        lambda watcher: cut_event_slices(client, plan, topics=topics, options=how, watcher=watcher)
    )
    for error in report.left_out:
        note(str(error))
    return transfer_output(report, elapsed_s)


def _around_ns(text: str) -> int:
    try:
        around_ns = int(read_duration(text))
    except ValueError as error:
        raise InvalidInput(what="--around", reason=str(error)) from None
    if around_ns > _MAX_AROUND_NS:
        raise InvalidInput(what="--around", reason="it is at most one day")
    return around_ns


def _planned(plan: EventSlicePlan) -> Output:
    items = [
        {"event": one.event.name, "local": str(one.local), "start_ns": one.start_ns, "end_ns": one.end_ns}
        for one in plan.slices
    ]
    rows = [
        (one.event.name, instant(one.start_ns), duration(one.end_ns - one.start_ns), str(one.local))
        for one in plan.slices
    ]
    note(f"Would cut {count(len(rows), 'event')}.")
    document = {"dry_run": True, "items": items, "left_out": [str(error) for error in plan.left_out]}
    return Output(document, lambda: table(["event", "start", "span", "to"], rows))
