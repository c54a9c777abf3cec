"""How actions look."""

from collections.abc import Iterable

from kleinkram.cli.render import details, line, table
from kleinkram.cli.units import duration, size
from kleinkram.contract.actions import ActionDefinition, ActionRead, ActionVersionRead, Inputs

_NS = 10**9


def show_actions(actions: Iterable[ActionRead]) -> None:
    """Print actions as a table."""
    table(
        ["project", "action", "version", "runs", "description", "changed", "by", "id"],
        [
            (
                row.project.name if row.project else "(whole lab)",
                row.name,
                row.latest.number,
                _what(row.latest.definition),
                row.description.partition("\n")[0],
                row.latest.created_at,
                row.latest.created_by.name,
                row.id,
            )
            for row in actions
        ],
    )


def show_action(action: ActionRead, version: ActionVersionRead) -> None:
    """Print an action in one version, and what it can be told."""
    definition, resources = version.definition, version.definition.resources
    details(
        [
            ("action", f"{action.name}@{version.number}"),
            ("of", action.project.name if action.project else "the whole lab"),
            ("id", action.id),
            ("archived", "yes: it is not listed, and starts no new runs" if action.archived else None),
            ("description", action.description),
            ("runs", _what(definition)),
            ("digest", version.image_digest),
            ("command", definition.command),
            ("needs", definition.dependencies),
            ("inputs", inputs(definition.inputs)),
            (
                "resources",
                f"{resources.cores:g} cores, {size(resources.memory_bytes)} memory, {size(resources.disk_bytes)} disk, "
                f"{resources.gpus} GPUs, {duration(resources.time_s * _NS)} at most",
            ),
            ("runners", resources.labels),
            ("network", definition.network.value),
            ("right", definition.right.value),
            ("published", f"{version.created_at:%Y-%m-%d %H:%M}Z by {version.created_by.name}"),
            ("etag", action.etag),
        ]
    )
    if definition.parameters:
        line("")
        table(
            ["parameter", "type", "default", "unit", "choices", "description"],
            [
                (entry.name, entry.type.value, _default(entry.default), entry.unit, entry.choices, entry.description)
                for entry in definition.parameters
            ],
        )


def show_versions(versions: Iterable[ActionVersionRead]) -> None:
    """Print the versions of an action as a table, as they come."""
    table(
        ["version", "runs", "digest", "published", "by", "id"],
        [
            (row.number, _what(row.definition), row.image_digest, row.created_at, row.created_by.name, row.id)
            for row in versions
        ],
    )


def inputs(resources: Inputs) -> str:
    """Return which files of a mission an action gets, in words."""
    lines = [("files", resources.paths), ("with topics", resources.topics), ("of types", resources.message_types)]
    return "; ".join(f"{what} {', '.join(globs)}" for what, globs in lines if globs) or "all files"


def _what(definition: ActionDefinition) -> str:
    if definition.script is None:
        return definition.image or ""
    return "a script" if definition.image is None else f"a script on {definition.image}"


def _default(value: object) -> object:
    return "(must be said)" if value is None else value if value != "" else '""'
