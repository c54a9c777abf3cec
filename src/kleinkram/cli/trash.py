"""`klein trash …`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import escape, note, show_json, show_json_list, table
from kleinkram.cli.units import size
from kleinkram.contract.projects import TrashNoun

app = Noun("What was deleted, for 30 days.")

NounOption = Annotated[TrashNoun | None, typer.Option("--noun", help="Only these.")]


@app.command("list")
def list_(noun: NounOption = None, as_json: AsJson = False) -> None:
    """List what can be had back."""
    with connect() as client:
        rows = [*client.trash.list(noun)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["noun", "name", "from", "files", "size", "deleted", "by", "gone after", "id"],
        [
            (
                row.noun.value,
                row.name,
                row.place,
                row.file_count,
                size(row.size_bytes),
                row.deleted_at,
                row.deleted_by.name,
                row.purged_after,
                row.id,
            )
            for row in rows
        ],
    )


@app.command("restore")
def restore(
    refs: Annotated[list[str], typer.Argument(metavar="NAME", help="Names or ids.", show_default=False)],
    noun: NounOption = None,
    as_json: AsJson = False,
) -> None:
    """Put deleted things back where they were."""
    with connect() as client:
        trash_rows = [client.trash.get(ref, noun=noun) for ref in refs]
        for row in trash_rows:
            client.trash.restore(row.noun, row.id)
            note(f"Restored the {row.noun.value} {escape(row.name)}.")
    if as_json:
        show_json({"items": trash_rows})
