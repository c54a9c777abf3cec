"""Output of transfers: progress bars on a terminal, else one line per file, on stderr; and the summary at the end."""

import contextlib
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict

from rich.console import Console
from rich.markup import escape as escape_markup
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from kleinkram.cli.errors import EXIT_CODES
from kleinkram.cli.render import escape, note
from kleinkram.cli.units import count, size
from kleinkram.client.errors import ClientError, request_id_of
from kleinkram.client.transfer import TransferReport, Watcher
from kleinkram.contract.errors import KleinkramError


@contextlib.contextmanager
def watching() -> Iterator[Watcher]:
    """Show a transfer for as long as it runs."""
    if not sys.stderr.isatty():
        yield Lines()
        return
    bars = Bars()
    with bars.progress:
        yield bars


class Lines:
    """One line a file."""

    def began(self, files: int, size_bytes: int) -> None:
        """Say nothing: the lines that follow say it."""

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Say nothing before the end."""

    def skipped(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Say nothing before the end."""

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """Say what became of a file."""
        note(f"{outcome:<10} {escape(path)}" + (f": {escape(reason)}" if reason else ""))

    def notify(self, text: str) -> None:
        """Pass it on."""
        note(escape(text))


class Bars:
    """A bar for the whole and one for each file that is moving, with rate and time left."""

    def __init__(self) -> None:
        self.progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            DownloadColumn(),
            TransferSpeedColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._lock = threading.Lock()
        self._whole: TaskID | None = None
        self._files: dict[str, TaskID] = {}

    def began(self, files: int, size_bytes: int) -> None:
        """Show the bar for the whole."""
        self._whole = self.progress.add_task(count(files, "file"), total=size_bytes)

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Move the bars on."""
        self.skipped(path, size_bytes, total_bytes)

    def skipped(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Move the bars on."""
        with self._lock:
            if path not in self._files:
                self._files[path] = self.progress.add_task(escape_markup(escape(path)), total=total_bytes)
            self.progress.advance(self._files[path], size_bytes)
            if self._whole is not None:
                self.progress.advance(self._whole, size_bytes)

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """Take a file's bar away, and say what became of it unless all is well."""
        with self._lock:
            if (task := self._files.pop(path, None)) is not None:
                self.progress.remove_task(task)
        if reason:
            self.notify(f"{outcome} {path}: {reason}")

    def notify(self, text: str) -> None:
        """Print above the bars."""
        self.progress.console.print(escape(text), markup=False, highlight=False)


def say_left_out(left_out: Iterable[ClientError]) -> None:
    """Name on stderr what will not be transferred."""
    for error in left_out:
        note(escape(str(error)))


def plain_report(report: TransferReport) -> dict[str, object]:
    """Return the stable JSON shape of a transfer's end."""
    items = [
        {
            "path": result.path,
            "local": str(result.local),
            "size_bytes": result.size_bytes,
            "outcome": result.outcome.value,
            "moved_bytes": result.moved_bytes,
            "file_id": str(result.file_id) if result.file_id else None,
            "sha256": result.sha256,
            "error": plain_error(result.error),
        }
        for result in report.results
    ]
    left_out = [plain_error(error) for error in report.left_out]
    return {"items": items, "left_out": left_out, "link": asdict(report.link)}


def say_summary(report: TransferReport, elapsed_s: float) -> None:
    """Say on stderr what was moved, how fast, and what became of the files."""
    moved = sum(result.moved_bytes for result in report.results)
    counts = Counter(result.outcome.value for result in report.results)
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())) or "nothing"
    speed = f", {size(int(moved / elapsed_s))}/s" if moved and elapsed_s > 0 else ""
    note(f"{outcomes}; {size(moved)} in {elapsed_s:.1f} s{speed}")
    if (advice := report.link.advice()) is not None:
        note(advice)
    for request_id in sorted({found for error in report.failures if (found := request_id_of(error))}):
        note(f"Request id: {escape(request_id)}")


def plain_error(error: KleinkramError | None) -> dict[str, object] | None:
    """Return the stable JSON shape of a failure."""
    if error is None:
        return None
    return {"kind": type(error).__name__, "message": str(error), "exit_code": int(EXIT_CODES[type(error)])}
