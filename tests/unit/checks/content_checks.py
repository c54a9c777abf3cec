"""Runs content checks of a `checks.yaml` on recordings in memory."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike

from kleinkram.checks.content import OpenRecording, check_content
from kleinkram.checks.document import read_checks
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings import Recording
from kleinkram.recordings.recording_files import Openable
from tests.recording_files.ros_messages import TimedMessage, ros1_bag, ros2_mcap

OK, ERROR, WARNING, NOT_MADE = CheckStatus.ok, CheckStatus.error, CheckStatus.warning, CheckStatus.not_made


def run(rules: str, *recordings: Openable, budget_bytes: int | None = None) -> list[Check]:
    """Return the rows of one profile with these sections; recordings are named "a", "b", ..."""
    indented = "\n".join(f"    {line}" for line in rules.strip().splitlines())
    document = read_checks(f"version: 1\nprofiles:\n  - name: test\n{indented}\n")
    opened = [OpenRecording("abcdef"[number], Recording.open(source)) for number, source in enumerate(recordings)]
    try:
        return check_content(document.profiles, opened, budget_bytes=budget_bytes)
    finally:
        for item in opened:
            assert item.recording is not None
            item.recording.close()


def statuses(rows: Iterable[Check]) -> dict[str, CheckStatus]:
    """Return the status of each check, of which there must be one row each."""
    rows = list(rows)
    result = {row.name: row.status for row in rows}
    assert len(result) == len(rows), rows
    return result


def only(rows: Iterable[Check], name: str) -> Check:
    """Return the one row of this name."""
    (row,) = (row for row in rows if row.name == name)
    return row


def in_ros1_and_ros2(messages: Iterable[TimedMessage]) -> list[str | PathLike[str] | Openable]:
    """Return the same messages as bag and as MCAP."""
    messages = list(messages)
    return [ros1_bag(messages), ros2_mcap(messages)]
