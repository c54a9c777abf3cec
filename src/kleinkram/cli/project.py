"""`klein project …`"""

from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import (
    AsJson,
    DryRun,
    IfMatch,
    Limit,
    ProjectOption,
    Yes,
    complete_project,
    confirm,
    read_text,
    the_ref,
)
from kleinkram.cli.render import details, line, note, show_json, show_json_list, table
from kleinkram.cli.units import count, parse_size, size, total_hours
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.projects import ProjectRead, ProjectSort

app = Noun("Projects: the top of project > mission > file.")

NameArgument = Annotated[
    str | None, typer.Argument(metavar="PROJECT", show_default=False, autocompletion=complete_project)
]
DescriptionOption = Annotated[str | None, typer.Option("--description", "-d", help="What it is about.")]
FieldsOption = Annotated[
    Path | None,
    typer.Option("--fields", metavar="fields.yaml", help="The metadata fields that each mission has, or must have."),
]


@app.command("create")
def create(
    name: NameArgument = None,
    project: ProjectOption = None,
    description: DescriptionOption = None,
    fields: FieldsOption = None,
    as_json: AsJson = False,
) -> None:
    """Make a project."""
    with connect() as client:
        made = client.projects.create(
            the_ref("project", name, project), description=description or "", fields_yaml=read_text(fields)
        )
    _show(made, as_json)


@app.command("list")
def list_(
    name: Annotated[str | None, typer.Argument(metavar="GLOB", show_default=False)] = None,
    text: Annotated[str | None, typer.Option("--text", help="Found in names and descriptions.")] = None,
    sort: Annotated[ProjectSort | None, typer.Option("--sort", help="Order; a - turns it round.")] = None,
    limit: Limit = None,
    count: Annotated[bool, typer.Option("--count", help="Only say how many.")] = False,
    as_json: AsJson = False,
) -> None:
    """List projects."""
    with connect() as client:
        if count:
            number = client.projects.count(name=name, text=text)
            show_json({"total": number}) if as_json else line(str(number))
            return
        rows = [*client.projects.list(name=name, text=text, sort=sort, limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["name", "missions", "files", "size", "recorded", "id"],
        [(row.name, row.mission_count, row.file_count, size(row.size_bytes), _hours(row), row.id) for row in rows],
    )


@app.command("info")
def info(name: NameArgument = None, project: ProjectOption = None, as_json: AsJson = False) -> None:
    """Show one project and the metadata fields it declares."""
    with connect() as client:
        found = client.projects.get(the_ref("project", name, project))
    _show(found, as_json)


@app.command("update")
def update(
    name: NameArgument = None,
    project: ProjectOption = None,
    new_name: Annotated[str | None, typer.Option("--name", help="Its new name.")] = None,
    description: DescriptionOption = None,
    fields: FieldsOption = None,
    public: Annotated[
        bool | None, typer.Option("--public/--private", help="Whether anybody may read it.", show_default=False)
    ] = None,
    licence: Annotated[str | None, typer.Option("--licence", help="An SPDX identifier, such as CC-BY-4.0.")] = None,
    citation: Annotated[str | None, typer.Option("--citation", help="How to cite it.")] = None,
    quota_bytes: Annotated[
        str | None, typer.Option("--quota-bytes", metavar="SIZE", help="At most so much, such as 2TB; or none.")
    ] = None,
    quota_files: Annotated[
        str | None, typer.Option("--quota-files", metavar="N", help="At most so many files; or none.")
    ] = None,
    etag: IfMatch = None,
    as_json: AsJson = False,
) -> None:
    """Change a project. Missions that do not satisfy new fields are reported, not broken.

    To publish takes DELETE on it; quotas are set by admins.
    """
    changes: dict[str, str | bool | int | None] = {"name": new_name, "description": description}
    changes |= {"fields_yaml": read_text(fields), "is_public": public, "licence": licence, "citation": citation}
    given = {key: value for key, value in changes.items() if value is not None} | _quotas(quota_bytes, quota_files)
    with connect() as client:
        found = client.projects.get(the_ref("project", name, project))
        changed = client.projects.update(found.id, if_match=etag or found.etag, **given)
    _show(changed, as_json)
    if changed.unsatisfied_mission_count:
        note(
            f"{changed.unsatisfied_mission_count} missions do not satisfy the fields: "
            f"klein mission list -p {changed.id} --unsatisfied"
        )


@app.command("delete")
def delete(
    name: NameArgument = None,
    project: ProjectOption = None,
    dry_run: DryRun = False,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Move a project, and all in it, to the trash."""
    with connect() as client:
        found = client.projects.get(the_ref("project", name, project))
        would = client.projects.delete(found.id, dry_run=True)
        what = (
            f"{found.name}: {count(would.missions, 'mission')}, {count(would.files, 'file')}, {size(would.size_bytes)}"
        )
        if not dry_run:
            confirm(f"Move to the trash {what}?", yes)
            would = client.projects.delete(found.id)
    show_json(would) if as_json else note(f"{'Would move' if dry_run else 'Moved'} to the trash: {what}")


def _quotas(quota_bytes: str | None, quota_files: str | None) -> dict[str, int | None]:
    """Return what to set; `none` lifts a quota."""
    given = {"quota_bytes": quota_bytes, "quota_files": quota_files}
    return {
        name: None if text == "none" else parse_size(text) if name == "quota_bytes" else _count(text)
        for name, text in given.items()
        if text is not None
    }


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit()):
        raise InvalidInput(what=f"The number of files {text!r}", reason="say a number, or none")
    return int(text)


def _used(used: object, quota: object) -> str | None:
    return None if quota is None else f"{used} of {quota}"


def _show(project: ProjectRead, as_json: bool) -> None:
    if as_json:
        show_json(project)
        return
    details(
        [
            ("project", project.name),
            ("id", project.id),
            ("etag", project.etag),
            ("description", project.description),
            ("created", f"{project.created_at:%Y-%m-%d %H:%M}Z by {project.created_by.name}"),
            ("missions", project.mission_count),
            ("files", f"{project.file_count}, {size(project.size_bytes)}"),
            ("recorded", _hours(project)),
            ("public", project.is_public or None),
            ("licence", project.licence),
            ("citation", project.citation),
            ("quota", _used(size(project.used_bytes), size(project.quota_bytes))),
            ("quota of files", _used(project.used_files, project.quota_files)),
            ("unsatisfied missions", project.unsatisfied_mission_count or None),
            ("undeclared metadata", project.metadata_fields.undeclared.value),
        ]
    )
    if project.metadata_fields.fields:
        line("")
        table(
            ["field", "type", "required", "unit", "choices", "description"],
            [
                (field.name, field.type.value, field.required, field.unit, field.choices, field.description)
                for field in project.metadata_fields.fields
            ],
        )


def _hours(project: ProjectRead) -> str | None:
    return total_hours(project.duration_ns) if project.duration_ns else None
