"""`klein inspect`"""

from collections.abc import Sequence
from typing import Annotated

import typer

from kleinkram.cli.errors import ExitCode
from kleinkram.cli.inspect_progress import watching
from kleinkram.cli.inspect_view import show
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import escape, line, note, show_json
from kleinkram.client.errors import InvalidInput
from kleinkram.recordings.inspect import Inspection, inspect_paths, to_plain
from kleinkram.recordings.model import Content, Depth


def inspect(
    paths: Annotated[list[str], typer.Argument(metavar="PATH", help="Files and folders.", show_default=False)],
    deep: Annotated[
        bool, typer.Option("--deep", help="Read every byte: check all checksums, save what can be saved.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Say what is in local recordings: topics, types, counts, times, rates and gaps. Needs no server.

    A broken file is an answer too: exit code 0. Exit code 8 if a file or folder cannot be read, 2 if a path does not
    exist.
    """
    try:
        with watching(deep) as watch:
            found = inspect_paths(paths, depth=Depth.scan if deep else Depth.summary, progress=watch)
    except FileNotFoundError as error:
        raise InvalidInput(what=f"The path {error.filename}", reason="there is no such file or folder") from error
    if as_json:
        show_json({"items": [to_plain(one) for one in found]})
    else:
        _show_all(found)
    unreadable = [one for one in found if one.summary.content is Content.error]
    for one in unreadable:
        note(escape(one.summary.reason or one.path))
    if unreadable:
        raise typer.Exit(ExitCode.local_file)


def _show_all(found: Sequence[Inspection]) -> None:
    if not found:
        note("There are no recordings in it.")
    for number, one in enumerate(found):
        if number:
            line("")
        show(one)
