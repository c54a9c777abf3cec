"""How far a scan is: one bar on a terminal, on stderr; nothing elsewhere."""

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from kleinkram.cli.render import escape
from kleinkram.recordings.inspect import ScanProgress

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


@contextlib.contextmanager
def watching(deep: bool) -> Iterator[ScanProgress | None]:
    """Show a bar for each file that is scanned, for as long as it is."""
    if not deep or not sys.stderr.isatty():
        yield None
        return
    # Slow to import, and only for this.
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        yield _Bar(progress)


class _Bar:
    """The bar of the file that is being read."""

    def __init__(self, progress: "Progress") -> None:
        self._progress = progress
        self._task: TaskID | None = None

    def began(self, path: str, size_bytes: int) -> None:
        """Show a bar for the next file."""
        from rich.markup import escape as escape_markup

        self._task = self._progress.add_task(escape_markup(escape(path)), total=size_bytes)

    def moved(self, size_bytes: int) -> None:
        """Move the bar on."""
        if self._task is not None:
            self._progress.advance(self._task, size_bytes)

    def ended(self) -> None:
        """Take the bar away."""
        if self._task is not None:
            self._progress.remove_task(self._task)
            self._task = None
