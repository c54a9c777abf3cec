"""The metadata fields that a project declares, out of a `fields.yaml` or a form. Pure; all that is wrong is found."""

from collections.abc import Sequence

from pydantic import JsonValue, ValidationError
from pydantic_core import ErrorDetails, SchemaError

from kleinkram.contract.errors import FieldProblem, FieldsInvalid
from kleinkram.contract.metadata import MetadataField, MetadataFields
from kleinkram.contract.problems import message_of
from kleinkram.server.missions.metadata import Judge, Wrong
from kleinkram.server.yaml_text import Document, Path, read_yaml


def read_fields(text: str | None) -> MetadataFields:
    """Return the fields that a text declares; without one, or with an empty one, none.

    Raises:
        YamlInvalid: the text cannot be read.
        FieldsInvalid: the definitions are not usable; names every problem, with its place.
    """
    document = read_yaml(text or "")
    if document.value is None:
        return MetadataFields()
    if not isinstance(document.value, dict):
        message = "must say 'fields:' and below it the list of fields, one '- {name: ..., type: ...}' each"
        raise FieldsInvalid(problems=[FieldProblem(field="fields.yaml", message=message)])
    try:
        fields = MetadataFields.model_validate(document.value)
    except ValidationError as error:
        issues = [issue for issue in _told_once(error.errors()) if issue["loc"]]
        raise FieldsInvalid(
            problems=[*(_problem(document, issue) for issue in issues), *_declared_twice(document)]
        ) from None
    problems = [
        _placed(document, path, message)
        for at, field in enumerate(fields.fields)
        for path, message in _judged(at, field)
    ]
    if problems:
        raise FieldsInvalid(problems=problems)
    return fields


def usable_fields(fields: MetadataFields) -> MetadataFields:
    """Return fields that came from a form, if missions can be judged by them.

    Raises:
        FieldsInvalid: they are not usable; names every problem by its place, such as `fields.3.pattern`.
    """
    problems = [
        FieldProblem(field=".".join(map(str, path)), message=message)
        for at, field in enumerate(fields.fields)
        for path, message in _judged(at, field)
    ]
    if problems:
        raise FieldsInvalid(problems=problems)
    return fields


def _told_once(issues: Sequence[ErrorDetails]) -> list[ErrorDetails]:
    # A default may be of many types; that it is of none of them is one problem, not one for each.
    first: dict[Path, ErrorDetails] = {}
    for issue in issues:
        path = issue["loc"]
        if path[2:3] == ("default",):
            issue = {**issue, "loc": path[:3], "msg": "must be a text, a number, true, false, a date or a location"}
        first.setdefault(issue["loc"], issue)
    return list(first.values())


def _declared_twice(document: Document) -> list[FieldProblem]:
    listed = document.value.get("fields") if isinstance(document.value, dict) else None
    seen: set[str] = set()
    problems = []
    for at, one in enumerate(listed if isinstance(listed, list) else []):
        name = one.get("name") if isinstance(one, dict) else None
        if isinstance(name, str):
            if name.casefold() in seen:
                problems.append(_placed(document, ("fields", at, "name"), "is declared twice"))
            seen.add(name.casefold())
    return problems


def _problem(document: Document, issue: ErrorDetails) -> FieldProblem:
    return _placed(document, tuple(issue["loc"]), message_of(issue))


def _placed(document: Document, path: Path, message: str) -> FieldProblem:
    place = document.place(path)
    where = {"line": place.line, "column": place.column} if place else {}
    return FieldProblem(field=_spoken(document.value, path), message=message, **where)


def _spoken(value: JsonValue, path: Path) -> str:
    """Return a path with fields named rather than numbered, as far as they have names."""
    if len(path) > 1 and path[0] == "fields" and isinstance(path[1], int) and isinstance(value, dict):
        listed = value.get("fields")
        one = listed[path[1]] if isinstance(listed, list) else None
        name = one.get("name") if isinstance(one, dict) else None
        return ".".join([str(name or f"fields.{path[1]}"), *(str(part) for part in path[2:])])
    return ".".join(str(part) for part in path) or "fields.yaml"


def _judged(at: int, field: MetadataField) -> list[tuple[Path, str]]:
    try:
        judge = Judge(MetadataFields(fields=[field]))
    except SchemaError as error:
        reason = str(error).strip().splitlines()[-1].split("rror: ")[-1]
        return [(("fields", at, "pattern"), f"is not a regular expression: {reason}")]
    try:
        judge.accept_default(field)
    except Wrong as wrong:
        return [(("fields", at, "default"), str(wrong))]
    return []
