"""How a scrub looks: while it runs, one line on stderr; at its end, what it found."""

import sys
from collections.abc import Iterator

from kleinkram.cli.render import details, moment, note, table
from kleinkram.cli.units import size
from kleinkram.contract.admin import ScrubRead, ScrubState
from kleinkram.contract.files import BlobState

_DAMAGED = {BlobState.lost.value, BlobState.corrupt.value}


def follow(states: Iterator[ScrubState]) -> ScrubState:
    """Show how far a scrub is, and return how it ended; of a scrub there is at least one state."""
    state = next(states)
    for now in states:
        state = now
        if state.last is not None and state.last.ended_at is None and sys.stderr.isatty():
            note(f"{state.last.compared} objects compared" if state.last.started_at else "waiting for the worker")
    return state


def is_stopped(state: ScrubState) -> bool:
    """Say whether the last scrub did not go through."""
    return state.last is not None and state.last.stopped is not None


def is_damaged(state: ScrubState) -> bool:
    """Say whether any blob is lost or corrupt."""
    return any(row.count for row in state.blobs if row.state in _DAMAGED)


def show_scrub(state: ScrubState) -> None:
    """Print what the last scrub found, and how all blobs are."""
    if state.last is None:
        note("There was no scrub yet.")
    else:
        details(_found(state.last))
    details(
        [
            ("oldest verification", state.oldest_verification_at),
            ("verified again", f"after {state.again_after_days} days" if state.again_after_days else "only when asked"),
            ("scrubs", f"every {state.every_hours:g} hours" if state.every_hours else "only when asked"),
        ]
    )
    if state.blobs:
        table(["state", "count", "size"], [(row.state, row.count, size(row.size_bytes)) for row in state.blobs])
    if is_damaged(state):
        note("`klein file list --state lost --state corrupt` names them; uploading such a file again mends it.")
    if state.last is not None and state.last.stopped is not None:
        note(state.last.stopped)


def _found(last: ScrubRead) -> list[tuple[str, object]]:
    ended = "under way" if last.started_at else "waits for the worker"
    if last.ended_at is not None:
        ended = f"{moment(last.ended_at)}{' (stopped)' if last.stopped else ''}"
    return [
        ("began", last.started_at or last.created_at),
        ("ended", ended),
        ("compared", f"{last.compared} objects, {size(last.compared_bytes)}"),
        ("newly lost", last.lost),
        ("newly corrupt", last.corrupt),
        ("there again", last.found),
        ("of nobody", last.unknown),
    ]
