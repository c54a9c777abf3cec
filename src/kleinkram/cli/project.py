"""`klein project …`"""

from pathlib import Path
from typing import Annotated

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import (
    AsJson,
    Count,
    DryRun,
    GlobArgument,
    IfMatch,
    Limit,
    ProjectOption,
    Text,
    Yes,
    argument,
    complete_project,
    confirm,
    option,
    read_text,
    the_ref,
)
from kleinkram.cli.render import details, line, note, show_count, show_json, show_rows, table
from kleinkram.cli.units import count as count_of
from kleinkram.cli.units import parse_size, size, total_hours
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.projects import ProjectRead, ProjectSort

app = Noun("Manage projects, which contain missions, which contain files.")
NameArgument = Annotated[Text, argument("PROJECT", "Name or id of the project.", autocompletion=complete_project)]
DescriptionOption = Annotated[Text, option("--description -d", None, "Set the description.")]
FieldsOption = Annotated[
    Path | None, option("--fields", "fields.yaml", "Set the metadata fields of the missions, and which are required.")
]


@app.command("create")
def create(
    name: NameArgument = None,
    project: ProjectOption = None,
    description: DescriptionOption = None,
    fields: FieldsOption = None,
    as_json: AsJson = False,
) -> None:
    """Create a project."""
    with connect() as client:
        made = client.projects.create(
            the_ref("project", name, project), description=description or "", fields_yaml=read_text(fields)
        )
    _show(made, as_json)


@app.command("list")
def list_(
    name: GlobArgument = None,
    text: Annotated[Text, option("--text", None, "Search names and descriptions for TEXT.")] = None,
    sort: Annotated[ProjectSort | None, option("--sort", None, "Set the order; a leading - reverses it.")] = None,
    limit: Limit = None,
    count: Count = False,
    as_json: AsJson = False,
) -> None:
    """List projects."""
    with connect() as client:
        if count:
            show_count(client.projects.count(name=name, text=text), as_json)
            return
        show_rows(
            client.projects.list(name=name, text=text, sort=sort, limit=limit),
            as_json,
            ["name", "missions", "files", "size", "recorded", "id"],
            lambda row: (row.name, row.mission_count, row.file_count, size(row.size_bytes), _hours(row), row.id),
        )


@app.command("info")
def info(name: NameArgument = None, project: ProjectOption = None, as_json: AsJson = False) -> None:
    """Show one project and its metadata fields."""
    with connect() as client:
        _show(client.projects.get(the_ref("project", name, project)), as_json)


@app.command("update")
def update(
    name: NameArgument = None,
    project: ProjectOption = None,
    new_name: Annotated[Text, option("--name", None, "Set the name.")] = None,
    description: DescriptionOption = None,
    fields: FieldsOption = None,
    public: Annotated[
        bool | None, option("--public/--private", None, "Let everybody read it, or not.", show_default=False)
    ] = None,
    licence: Annotated[
        Text, option("--licence", None, "Set the licence, an SPDX identifier such as CC-BY-4.0.")
    ] = None,
    citation: Annotated[Text, option("--citation", None, "Set how to cite it.")] = None,
    quota_bytes: Annotated[Text, option("--quota-bytes", "SIZE", "Limit its size, such as to 2TB; or none.")] = None,
    quota_files: Annotated[Text, option("--quota-files", "N", "Limit its number of files; or none.")] = None,
    etag: IfMatch = None,
    as_json: AsJson = False,
) -> None:
    """Change a project. Missions whose metadata does not satisfy new fields are counted, not changed.

    Only those with DELETE on a project can publish it. Only admins can set quotas.
    """
    values = {
        "name": new_name,
        "description": description,
        "fields_yaml": read_text(fields),
        "is_public": public,
        "licence": licence,
        "citation": citation,
    }
    changes: dict[str, str | bool | int | None] = {key: value for key, value in values.items() if value is not None}
    if quota_bytes is not None:
        changes["quota_bytes"] = None if quota_bytes == "none" else parse_size(quota_bytes)
    if quota_files is not None and not (quota_files == "none" or (quota_files.isascii() and quota_files.isdigit())):
        raise InvalidInput(what=f"The number of files {quota_files!r}", reason="say a number, or none")
    if quota_files is not None:
        changes["quota_files"] = None if quota_files == "none" else int(quota_files)
    with connect() as client:
        target = client.projects.get(the_ref("project", name, project))
        changed = client.projects.update(target.id, if_match=etag or target.etag, **changes)
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
        target = client.projects.get(the_ref("project", name, project))
        would = client.projects.delete(target.id, dry_run=True)
        missions, files = count_of(would.missions, "mission"), count_of(would.files, "file")
        what = f"{target.name}: {missions}, {files}, {size(would.size_bytes)}"
        if not dry_run:
            confirm(f"Move to the trash {what}?", yes)
            would = client.projects.delete(target.id)
    show_json(would) if as_json else note(f"{'Would move' if dry_run else 'Moved'} to the trash: {what}")


def _show(project: ProjectRead, as_json: bool) -> None:
    if as_json:
        show_json(project)
        return
    used, files = size(project.used_bytes), project.used_files
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
            ("quota", f"{used} of {size(project.quota_bytes)}" if project.quota_bytes is not None else None),
            ("quota of files", f"{files} of {project.quota_files}" if project.quota_files is not None else None),
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
