"""How far a run says it is, read from its events while it lasts. It is a stranger's file, and may be of any size."""

from pathlib import Path

from pydantic import ValidationError

from kleinkram.contract.reports import EVENTS_FILE, MAX_EVENT_BYTES, Progress, ReportEvent
from kleinkram.runner.disk import open_inside

_MOST_BYTES = 2**20


class ProgressReader:
    """Reads what was added since the last look."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._offset = 0
        self.progress: Progress | None = None

    def look(self) -> None:
        """Take the last progress that was said; what is no event is passed over here, and told at the end."""
        try:
            stream = open_inside(self._out, EVENTS_FILE)
        except OSError:
            return
        if stream is None:
            return
        with stream:
            size = stream.seek(0, 2)
            # Where much was added, only the end of it is of interest.
            self._offset = stream.seek(max(self._offset, size - _MOST_BYTES))
            whole, line_end, _ = stream.read(_MOST_BYTES).rpartition(b"\n")
            self._offset += len(whole) + len(line_end)
        for line in reversed(whole.splitlines()):
            if b'"progress"' in line and len(line) <= MAX_EVENT_BYTES and self._take(line):
                return

    def _take(self, line: bytes) -> bool:
        try:
            said = ReportEvent.model_validate_json(line).progress
        except ValidationError:
            return False
        if said is None:
            return False
        self.progress = said
        return True
