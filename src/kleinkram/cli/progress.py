"""What a transfer looks like while it runs: bars on a terminal, else one line a file. Always on stderr."""

import contextlib
import sys
import threading
from collections.abc import Iterator

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

from kleinkram.cli.render import escape, note
from kleinkram.cli.units import count
from kleinkram.client.transfer import Watcher


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
