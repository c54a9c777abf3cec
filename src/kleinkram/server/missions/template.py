"""Writing the YAML to fill in for a project's next mission: every field explained, prefilled where possible. Pure."""

import json
import re

from pydantic import JsonValue

from kleinkram.contract.metadata import FieldType, Metadata, MetadataField, MetadataFields, Undeclared
from kleinkram.server.missions.metadata import Judge, Wrong, describe
from kleinkram.server.yaml_text import resolve_plain

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*( [A-Za-z0-9_.-]+)*")
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")


def prefilled(fields: MetadataFields, last: Metadata) -> Metadata:
    """Return the values to begin with: those of the last mission that still fit, else defaults.

    A date is not taken over: it would be the wrong one, and nobody would be asked for theirs.
    """
    judge = Judge(fields)
    values = {field.name: _prefilled(judge, field, last.get(field.name)) for field in fields.fields}
    declared = {name.casefold() for name in values}
    others = {key: value for key, value in last.items() if key.casefold() not in declared}
    kept = {name: value for name, value in values.items() if value is not None}
    return kept | (others if fields.undeclared is Undeclared.accept else {})


def write_template(fields: MetadataFields, values: Metadata, *, project: str, source: str | None) -> str:
    """Return a document that parses, and that satisfies the fields once the required ones are filled in.

    `values` are those to begin with, and `source` is the name of the mission that they were taken from.
    """
    origin = f", prefilled from mission {source}" if source is not None else ""
    lines = [f"# Metadata of a mission in project {_comment(project)}{_comment(origin)}."]
    lines.append("# Fill in what is required; what is optional may stay empty or be deleted.")
    for field in fields.fields:
        lines += ["", *_explained(field), _line(field.name, values.get(field.name))]
    declared = {field.name for field in fields.fields}
    others = {key: value for key, value in values.items() if key not in declared}
    if others:
        lines += ["", "# Not declared by the project, but given for the last mission:"]
        lines += [_line(key, value) for key, value in others.items()]
    return "\n".join(lines) + "\n"


def _explained(field: MetadataField) -> list[str]:
    need = "required" if field.required else "optional"
    lines = [f"# {field.name} ({need}): {_comment(describe(field))}"]
    return lines + [f"#   {_comment(line)}" for line in field.description.splitlines() if line.strip()]


def _prefilled(judge: Judge, field: MetadataField, last: JsonValue) -> JsonValue:
    if last is not None and field.type is not FieldType.date:
        try:
            return judge.accept(field.name, last)
        except Wrong:
            return judge.accept_default(field)
    return judge.accept_default(field)


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
