"""What goes wrong while a recording is read: each thing once, and no more of them than a person would read."""

from __future__ import annotations

from collections.abc import Iterable

from kleinkram.recordings.limits import MAX_PROBLEMS
from kleinkram.recordings.model import Problem, counted


class Noticed:
    """The problems of one recording so far."""

    def __init__(self) -> None:
        self._problems: dict[tuple[str, str], Problem] = {}
        self._left_out = 0
        self._late = 0

    def add(self, code: str, where: str, message: str) -> None:
        """Note a problem; the second of a code and a place is the first one met again."""
        if (code, where) in self._problems:
            return
        if len(self._problems) < MAX_PROBLEMS:
            self._problems[code, where] = Problem(code, where, message)
        else:
            self._left_out += 1

    def note_late(self, messages: int) -> None:
        """Note how many messages one iteration has left out, so far, because they came too late to be in order."""
        self._late = max(self._late, messages)

    def all(self, known: Iterable[Problem] = ()) -> tuple[Problem, ...]:
        """Return the problems in the order in which they were met, behind those that were `known` from elsewhere."""
        merged: dict[tuple[str, str], Problem] = {}
        for problem in (*known, *self._problems.values()):
            merged.setdefault((problem.code, problem.where), problem)
        found = list(merged.values())
        if self._late:
            late = counted(self._late, "message is", "messages are")
            message = f"{late} left out: earlier than the index says, too late to be put in order"
            found.append(Problem("too-late", "messages", message))
        if self._left_out:
            message = f"{self._left_out} more problems are not listed"
            found.append(Problem("more-problems", "file", message))
        return tuple(found)
