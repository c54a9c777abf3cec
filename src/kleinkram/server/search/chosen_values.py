"""Facets and the filter: what is chosen of a facet, the filter without it, and with one value more or less. Pure."""

import fnmatch
import re
from collections.abc import Sequence
from typing import Any

from kleinkram.contract.files import FileFilter
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.names import name_key
from kleinkram.contract.query import META

# Facet -> the field of the filter whose list it fills.
LISTS = {
    "format": "format",
    "content": "content",
    "topic": "topic",
    "type": "message_type",
    "label": "label",
    "month": "month",
}
NUMBER = re.compile(r"[-+]?(\d{1,18}|\d{0,18}\.\d{1,18})([eE][-+]?\d{1,2})?", re.ASCII)
_PLAIN = re.compile(r"[^\s*?\"\\]+")


def chosen(matching: FileFilter, facet: str) -> list[str]:
    """Return the values of a facet that a filter asks for."""
    if facet == "project":
        return [*matching.projects] if matching.project is None else [matching.project, *matching.projects]
    if facet.startswith(META):
        return [value for field, value in map(_equality, matching.where) if field == facet.removeprefix(META)]
    return [str(getattr(value, "value", value)) for value in getattr(matching, LISTS[facet])]


def fields(matching: FileFilter) -> list[str]:
    """Return the metadata fields of which a filter asks for a value, in order; not those inside of others."""
    return sorted({field for field, _ in map(_equality, matching.where) if field and "." not in field})


def without(matching: FileFilter, facet: str) -> FileFilter:
    """Return a filter that leaves open what the facet says."""
    if facet == "project":
        return _with(matching, project=None, project_id=None, projects=[])
    if facet.startswith(META):
        field = facet.removeprefix(META)
        return _with(matching, where=[item for item in matching.where if _equality(item)[0] != field])
    return _with(matching, **{LISTS[facet]: []})


def with_value(matching: FileFilter, facet: str, value: str, *, kind: str = "string") -> FileFilter:
    """Return a filter that asks for one value more of a facet; where only one can be asked for, for this one.

    `kind` is what the value of a metadata field is: string, number or boolean.
    """
    if facet == "project":
        return _with(matching, project=value, project_id=None, projects=[])
    if facet.startswith(META):
        bare = without(matching, facet)
        return _with(bare, where=[*bare.where, comparison(facet.removeprefix(META), value, kind)])
    wider = [item for item in chosen(matching, facet) if item != value and fnmatch.fnmatchcase(value, item)]
    narrower = [item for item in chosen(matching, facet) if item not in wider]
    return _with(matching, **{LISTS[facet]: [*narrower, value]})


def without_value(matching: FileFilter, facet: str, value: str) -> FileFilter:
    """Return a filter that no longer asks for a value of a facet."""
    if facet == "project" and matching.projects:
        left = [item for item in matching.projects if name_key(item) != name_key(value)]
        return _with(matching, projects=left)
    if facet not in LISTS:
        return without(matching, facet)
    return _with(matching, **{LISTS[facet]: [item for item in chosen(matching, facet) if item != value]})


def is_selected(values: Sequence[str], facet: str, value: str) -> bool:
    """Say whether a value is among those that a filter asks for; a project is so by its name in any case."""
    return name_key(value) in map(name_key, values) if facet == "project" else value in values


def can_be_filtered(value: str, kind: str) -> bool:
    """Say whether a filter can ask for a value: not for an empty one, several lines, or a number of many digits."""
    return bool(value) and "\n" not in value and (kind != "number" or NUMBER.fullmatch(value) is not None)


def comparison(field: str, value: str, kind: str) -> str:
    """Return the comparison that holds of just this value of a metadata field."""
    reads_otherwise = NUMBER.fullmatch(value) is not None or value.lower() in {"true", "false"}
    is_bare = kind != "string" or (_PLAIN.fullmatch(value) is not None and not reads_otherwise)
    return f"{field}={value}" if is_bare else f'{field}="{value}"'


def _equality(expression: str) -> tuple[str, str]:
    """Return field and value of a comparison for equality; two empty texts for any other."""
    match = WHERE_EXPRESSION.fullmatch(expression.strip())
    if match is None or match["operator"] != "=":
        return "", ""
    value = match["value"].strip()
    is_text = len(value) > 1 and value.startswith('"') and value.endswith('"')
    return match["field"], value[1:-1] if is_text else value


def _with(matching: FileFilter, **changed: Any) -> FileFilter:  # Any: fields of the filter
    # Of what is shown, each value has such a filter: what came from a filter, or from the files, is not judged again.
    return matching.model_copy(update=changed)
