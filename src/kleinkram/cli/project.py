"""`klein project …`"""

from pathlib import Path
from typing import Annotated

from kleinkram.cli import options, project_actions
from kleinkram.cli.commands import Subcommands, Text, argument, option
from kleinkram.cli.render import Output, as_table, as_total, details, line, note, table
from kleinkram.cli.units import count as count_of
from kleinkram.cli.units import parse_size, size, total_hours
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.projects import ProjectRead, ProjectSort

app = Subcommands("Manage projects, which contain missions, which contain files.")
app.add_typer(project_actions.app, name="actions")
NameArgument = Annotated[
    Text, argument("PROJECT", "Name or id of the project.", autocompletion=options.complete_project)
]
DescriptionOption = Annotated[Text, option("--description -d", None, "Set the description.")]
FieldsOption = Annotated[
    Path | None, option("--fields", "fields.yaml", "Set the metadata fields of the missions, and which are required.")
]
# What a project's runs may do to each other, said once it is allowed.
_ALLOWED = {
    Isolation.container: "Runs of this project start only in containers.",
    Isolation.namespaces: "Runs of this project may also start in namespaces, without containers: they see no other "
    "runs and no other files, but share the machine's programs and users.",
    Isolation.none: "Runs of this project may also start without any isolation: they can read and change whatever "
    "their runner can, such as the inputs of other runs and its token.",
}


@app.command("create")
def create(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    description: DescriptionOption = None,
    fields: FieldsOption = None,
) -> Output:
    """Create a project."""
    name = options.the_ref("project", name, project)
    fields_yaml = options.read_text(fields)
    return _output(client.projects.create(name, description=description or "", fields_yaml=fields_yaml))


@app.command("list")
def list_(
    client: Client,
    name: options.GlobArgument = None,
    text: Annotated[Text, option("--text", None, "Search names and descriptions for TEXT.")] = None,
    sort: Annotated[ProjectSort | None, option("--sort", None, "Set the order; a leading - reverses it.")] = None,
    limit: options.Limit = None,
    count: options.Count = False,
) -> Output:
    """List projects."""
    if count:
        return as_total(client.projects.count(name=name, text=text))
    return as_table(
        client.projects.list(name=name, text=text, sort=sort, limit=limit),
        ["name", "missions", "files", "size", "recorded", "id"],
        lambda row: (row.name, row.mission_count, row.file_count, size(row.size_bytes), _hours(row), row.id),
    )


@app.command("info")
def info(client: Client, name: NameArgument = None, project: options.ProjectOption = None) -> Output:
    """Show one project and its metadata fields."""
    return _output(client.projects.get(options.the_ref("project", name, project)))


@app.command("update")
def update(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    new_name: Annotated[Text, option("--name", None, "Set the name.")] = None,
    description: DescriptionOption = None,
    fields: FieldsOption = None,
    public: Annotated[
        bool | None, option("--public/--private", None, "Let everybody read it, or not.", show_default=False)
    ] = None,
    licence: Annotated[
        Text, option("--licence", None, "Set the licence, an SPDX identifier such as CC-BY-4.0.")
    ] = None,
    citation: Annotated[Text, option("--citation", None, "Set the citation.")] = None,
    isolation: Annotated[
        Isolation | None, option("--isolation", None, "Set the weakest isolation that its runs may have.")
    ] = None,
    quota_bytes: Annotated[Text, option("--quota-bytes", "SIZE", "Limit its size, such as to 2TB; or none.")] = None,
    quota_files: Annotated[Text, option("--quota-files", "N", "Limit its number of files; or none.")] = None,
    etag: options.IfMatch = None,
) -> Output:
    """Change a project. Missions whose metadata does not satisfy new fields are counted, not changed.

    Publishing a project, and setting its isolation, require DELETE on it. Only admins can set quotas.
    """
    values = {
        "name": new_name,
        "description": description,
        "fields_yaml": options.read_text(fields),
        "is_public": public,
        "licence": licence,
        "citation": citation,
        "isolation": isolation,
    }
    changes: dict[str, str | bool | int | None] = {key: value for key, value in values.items() if value is not None}
    if quota_bytes is not None:
        changes["quota_bytes"] = None if quota_bytes == "none" else parse_size(quota_bytes)
    if quota_files is not None and not (quota_files == "none" or (quota_files.isascii() and quota_files.isdigit())):
        raise InvalidInput(what=f"The number of files {quota_files!r}", reason="specify a number or none")
    if quota_files is not None:
        changes["quota_files"] = None if quota_files == "none" else int(quota_files)
    target = client.projects.get(options.the_ref("project", name, project))
    changed = client.projects.update(target.id, if_match=etag or target.etag, **changes)
    if changed.unsatisfied_mission_count:
        note(
            f"{count_of(changed.unsatisfied_mission_count, 'mission')} do not satisfy the fields: "
            f"klein mission list -p {changed.id} --unsatisfied"
        )
    if changed.isolation is not target.isolation:
        note(_ALLOWED[changed.isolation])
    return _output(changed)


@app.command("delete")
def delete(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    dry_run: options.DryRun = False,
    yes: options.Yes = False,
) -> Output:
    """Move a project, and all in it, to the trash."""
    target = client.projects.get(options.the_ref("project", name, project))
    would = client.projects.delete(target.id, dry_run=True)
    missions, files = count_of(would.missions, "mission"), count_of(would.files, "file")
    what = f"{target.name}: {missions}, {files}, {size(would.size_bytes)}"
    if not dry_run:
        options.confirm(f"Move to the trash {what}?", yes)
        would = client.projects.delete(target.id)
    return Output(would, f"{'Would move' if dry_run else 'Moved'} to the trash: {what}")


def _output(project: ProjectRead) -> Output:
    return Output(project, lambda: _show(project))


def _show(project: ProjectRead) -> None:
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
            ("isolation of runs", f"{project.isolation.value}, or stronger"),
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
