"""`klein download`"""

import time
from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.errors import Interrupted, exit_code_of
from kleinkram.cli.filters import Choice, Many, select_files, with_choice
from kleinkram.cli.options import AsJson, Connections, DryRun, ExcludeOption, LimitRate
from kleinkram.cli.render import note, show_json, table
from kleinkram.cli.transfer_view import plain_report, say_left_out, say_summary
from kleinkram.cli.units import count, parse_rate, size
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.transfer import DownloadPlan, plan_download
from kleinkram.client.transfer.download import CONNECTIONS
from kleinkram.client.transfer.download import download as download_files
from kleinkram.client.transfer.plan import is_excluded
from kleinkram.contract.tokens import is_link


@with_choice
def download(
    choice: Choice,
    filters: Annotated[
        Many,
        typer.Argument(
            metavar="FILTERS", help="Paths, globs or ids of files; or the address of a link.", show_default=False
        ),
    ] = None,
    dest: Annotated[Path, typer.Option("--dest", metavar="D", help="Folder to write into.")] = Path(),
    nested: Annotated[bool, typer.Option("--nested", help="Write to PROJECT/MISSION/PATH below it.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that differ.")] = False,
    exclude: ExcludeOption = None,
    limit_rate: LimitRate = None,
    connections: Connections = CONNECTIONS,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Download files, each verified before it gets its name. The same command again resumes."""
    bytes_per_s = parse_rate(limit_rate)
    links = [value for value in filters or [] if is_link(value)]
    refs = [value for value in filters or [] if not is_link(value)]
    if len(links) > 1:
        raise InvalidInput(what="The command", reason="say one link at a time")
    if choice.is_empty() and not filters:
        raise InvalidInput(what="The command", reason="say which files: -p, -m, a path, a glob ('*' for all) or an id")
    with connect(*links) as client:
        files = [file for file in select_files(client, choice, refs) if not is_excluded(file.path, exclude or [])]
        plan = plan_download(files, dest, nested=nested)
        say_left_out(plan.left_out)
        if not plan.targets and not plan.left_out:
            raise NothingToDo(reason="No file matches")
        if dry_run:
            _show_plan(plan, as_json)
            return
        from kleinkram.cli.transfer_view import watching

        began_at = time.monotonic()
        try:
            with watching() as watcher:
                report = download_files(
                    client,
                    plan,
                    overwrite=overwrite,
                    connections=connections,
                    bytes_per_s=bytes_per_s,
                    watcher=watcher,
                )
        except KeyboardInterrupt:
            raise Interrupted from None
    elapsed_s = time.monotonic() - began_at
    if as_json:
        show_json({"elapsed_s": elapsed_s, **plain_report(report)})
    say_summary(report, elapsed_s)
    if code := exit_code_of([*report.failures, *report.left_out]):
        raise typer.Exit(code)


def _show_plan(plan: DownloadPlan, as_json: bool) -> None:
    if as_json:
        items = [
            {"path": target.file.path, "local": str(target.local), "size_bytes": target.file.size_bytes}
            for target in plan.targets
        ]
        show_json({"dry_run": True, "items": items, "left_out": [str(error) for error in plan.left_out]})
        return
    rows = [(target.file.path, size(target.file.size_bytes), str(target.local)) for target in plan.targets]
    table(["path", "size", "to"], rows)
    note(f"Would download {count(len(plan.targets), 'file')}, {size(plan.size_bytes)}.")
