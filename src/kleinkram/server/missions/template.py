"""Writing the YAML to fill in for the next mission of a project: each field with what the last one said. Pure."""

import json
import re

from pydantic import JsonValue

from kleinkram.contract.metadata import FieldType, Metadata, MetadataField, MetadataFields, Undeclared
from kleinkram.server.missions.metadata import Judge, Wrong, describe
from kleinkram.server.yaml_text import resolve_plain

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*( [A-Za-z0-9_.-]+)*")
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
_DATED = re.compile(r"\d{4}-\d{2}-\d{2}([T ].*)?")
# Fields that say what differs from one mission to the next, whatever their type.
_OF_ONE_MISSION = frozenset({"date", "day", "time", "weather", "operator", "operators", "driver", "pilot"})
_NAME_PARTS = re.compile(r"[a-z]+|[A-Z][a-z]*")


def defaults(fields: MetadataFields) -> Metadata:
    """Return the values that the project itself says to begin with."""
    judge = Judge(fields)
    values = {field.name: judge.accept_default(field) for field in fields.fields}
    return {name: value for name, value in values.items() if value is not None}


def carried_over(fields: MetadataFields, last: Metadata) -> Metadata:
    """Return the values of the last mission that still fit. Whoever makes the next mission has to confirm them.

    Dates, weather and operator are left out: they differ, and a wrong one would look as if somebody had entered it.
    """
    judge = Judge(fields)
    begun = defaults(fields)
    declared = {field.name: field for field in fields.fields}
    known = {name.casefold() for name in declared}
    found: Metadata = {}
    for name, value in last.items():
        field = declared.get(name)
        if value is None or _differs(name, value) or (field is not None and field.type is FieldType.date):
            continue
        if field is not None:
            try:
                found[name] = judge.accept(name, value)
            except Wrong:
                continue
        elif fields.undeclared is Undeclared.accept and name.casefold() not in known:
            found[name] = value
    return {name: value for name, value in found.items() if begun.get(name) != value}


def _differs(name: str, value: JsonValue) -> bool:
    parts = {part.lower() for part in _NAME_PARTS.findall(name)}
    return not parts.isdisjoint(_OF_ONE_MISSION) or (isinstance(value, str) and _DATED.fullmatch(value) is not None)


def write_template(
    fields: MetadataFields, values: Metadata, carried: Metadata, *, project: str, source: str | None
) -> str:
    """Return a document that parses, and that satisfies the fields once the required ones are filled in.

    `values` are those to begin with. `carried` are those of the mission called `source`: they stand in comments, so
    that nothing of an earlier mission is taken over unless somebody writes it.
    """
    lines = [f"# Metadata of a mission in project {_comment(project)}."]
    lines.append("# Fill in what is required; what is optional may stay empty or be deleted.")
    mission = _comment(source or "")
    for field in fields.fields:
        lines += ["", *_explained(field)]
        if field.name in carried:
            lines.append(f"#   In mission {mission}: {_yaml(carried[field.name])}")
        lines.append(_line(field.name, values.get(field.name)))
    declared = {field.name for field in fields.fields}
    others = {key: value for key, value in carried.items() if key not in declared}
    if others:
        lines += ["", f"# Not declared by the project, but given for mission {mission}. Remove the # to say it again:"]
        lines += [f"# {_line(key, value)}" for key, value in others.items()]
    return "\n".join(lines) + "\n"


def _explained(field: MetadataField) -> list[str]:
    need = "required" if field.required else "optional"
    lines = [f"# {field.name} ({need}): {_comment(describe(field))}"]
    return lines + [f"#   {_comment(line)}" for line in field.description.splitlines() if line.strip()]


def _line(key: str, value: JsonValue) -> str:
    return f"{_yaml(key)}:" if value is None else f"{_yaml(key)}: {_yaml(value)}"


def _yaml(value: JsonValue) -> str:
    if isinstance(value, str):
        plain = _DATE.fullmatch(value) or (_PLAIN.fullmatch(value) and resolve_plain(value) == value)
        return value if plain else _quoted(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_yaml(key)}: {_yaml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    return json.dumps(value)


def _quoted(text: str) -> str:
    quoted = json.dumps(text, ensure_ascii=False)
    return "".join(each if each.isprintable() else f"\\U{ord(each):08X}" for each in quoted)


def _comment(text: str) -> str:
    return "".join(each if each.isprintable() else " " for each in text)
