"""Filters of files as SQL: conditions on a select that began with `visible_files`, comparisons with metadata included.

A comparison (`robot=anymal`, `temperature>20`, `site~zur*`) holds only where the mission has the field, whatever the
operator. Numbers compare as numbers, all else as text by code point (so ISO dates compare as dates); a value in double
quotes is text even if it looks like a number. `=` and `!=` also look into lists. Every value is a bound parameter.
"""

import datetime
import itertools
import re
import uuid
from collections.abc import Sequence
from typing import TypeVar
from unicodedata import normalize

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Numeric,
    Select,
    Table,
    Text,
    and_,
    any_,
    bindparam,
    case,
    cast,
    exists,
    false,
    func,
    literal,
    not_,
    or_,
    select,
    true,
    type_coerce,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONB

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.missions import MissionFilter
from kleinkram.contract.names import is_id
from kleinkram.contract.query import parse_term
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import ArrayText, like_pattern, matches_any, matches_key
from kleinkram.server.filters.dates import iso_text, nanoseconds
from kleinkram.server.filters.mission_events import recorded_during_event
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan, words_of
from kleinkram.server.filters.text import (
    NO_TIME,
    WordInMission,
    blob_has_topic,
    file_contains,
    mission_may_have_topic,
    path_condition,
    plan_conditions,
    topics_of_blob,
    word_in_mission,
)
from kleinkram.server.filters.verdicts import check_conditions
from kleinkram.server.tables import blob, file, mission, mission_topic, project, topic

Conditions = list[ColumnElement[bool]]
Row = TypeVar("Row", bound=tuple[object, ...])
_HIDDEN = "this credential does not show the metadata of missions"
_NUMBER = re.compile(r"[-+]?(\d{1,18}|\d{0,18}\.\d{1,18}|\d{1,18}\.)([eE][-+]?\d{1,2})?", re.ASCII)
# So many characters of a text decide its position in a list: they also fit into the cursor of a page.
_KEY_CHARACTERS = 100
_Scalar = str | bool | int | float


def filter_files(actor: Actor, stmt: Select[Row], matching: FileFilter, plan: SearchPlan = NO_PLAN) -> Select[Row]:
    """Return the files of a select that match.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    return stmt.where(*file_conditions(actor, matching, plan))


def file_conditions(actor: Actor, matching: FileFilter, plan: SearchPlan = NO_PLAN) -> Conditions:
    """Return the conditions of a filter on `file`, `mission`, `project` and `blob`.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    if plan.matched is not None:
        return [file.c.id == any_(bindparam("matched_file_ids", type_=ArrayText("UUID")))]
    words = words_of(matching.text)
    conditions = _field_conditions(actor, matching) + plan_conditions(plan)
    conditions += [file_contains(actor, plan, word) for word in words]
    if matching.topic or matching.message_type:
        # As EXISTS, so that PostgreSQL can start from a rare topic.
        conditions.append(topics_of_blob().where(*topic_conditions(matching)).exists())
    return conditions


def _field_conditions(actor: Actor, matching: FileFilter) -> Conditions:
    """Return the conditions of a filter except those on words and topics."""
    refuse_metadata(actor, matching.where)
    conditions = project_conditions(matching) + span_conditions(matching, file.c.start_ns, blob.c.end_ns)
    conditions += _start_conditions(matching) + _blob_conditions(matching)
    if matching.mission is not None:
        conditions.append(matches_key(mission.c.name_key, matching.mission))
    if matching.mission_id is not None:
        conditions.append(mission.c.id == matching.mission_id)
    conditions += any_of(mission, matching.missions)
    conditions += recorded_during_event(actor, matching.event)
    conditions += check_conditions(actor, matching)
    if matching.recording_id is not None:
        conditions.append(file.c.recording_id == matching.recording_id)
    if matching.path:
        conditions.append(or_(*(path_condition(matches_key(file.c.path_key, glob)) for glob in matching.path)))
    if matching.label:
        conditions.append(_has_label(matching.label))
    conditions += [metadata_condition(expression) for expression in matching.where]
    return conditions + [negation(file_conditions(actor, parse_term(term))) for term in matching.without]


def filter_files_in_order(
    actor: Actor, stmt: Select[Row], matching: FileFilter, plan: SearchPlan, *, of_one_mission: bool = False
) -> Select[Row]:
    """Return the files of a select that match, to be read in the order of an index until a page is full.

    Conditions on the mission of a file are evaluated once per mission, which may have thousands of files: PostgreSQL
    memoizes a lateral join behind OFFSET 0. Without this, a word of topics takes 118 instead of 16 ms (200 000
    files, the newest mission having 4 000). With `of_one_mission`, the files are those of the `mission` of the
    statement around it.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    words = [word_in_mission(actor, plan, word) for word in words_of(matching.text)]
    columns = [condition.label(f"about_{number}") for number, condition in enumerate(itertools.chain(*words))]
    has_topics = bool(matching.topic or matching.message_type)
    if has_topics:
        may_have_topic = mission_may_have_topic(*topic_conditions(matching, mission_topic))
        columns.append(may_have_topic.label("may_have_topic"))
    if not columns:
        return filter_files(actor, stmt, matching, plan)
    of_mission = select(*columns)
    if of_one_mission:
        of_mission = of_mission.correlate(mission)
    else:
        of_mission = of_mission.where(mission.c.id == file.c.mission_id).correlate(file)
    its = of_mission.offset(0).lateral("its_mission")
    conditions: Conditions = []
    for number, word in enumerate(words_of(matching.text)):
        in_mission = WordInMission(its.c[f"about_{2 * number}"], its.c[f"about_{2 * number + 1}"])
        conditions.append(file_contains(actor, plan, word, in_mission))
    if has_topics:
        # As CASE, so that topics are looked up last.
        has_topic = blob_has_topic(*topic_conditions(matching))
        conditions = [case((and_(its.c.may_have_topic, *conditions), has_topic), else_=false())]
    fields = _field_conditions(actor, matching) + plan_conditions(plan)
    return stmt.outerjoin(its, true()).where(*fields, *conditions)


def filter_topics(stmt: Select[Row], matching: FileFilter) -> Select[Row]:
    """Return the topics of a select joined with them that match the filter's topics and message types."""
    return stmt.where(*topic_conditions(matching))


def topic_conditions(matching: MissionFilter | FileFilter, table: Table = topic) -> Conditions:
    """Return the conditions of a filter on one topic."""
    conditions: Conditions = []
    if matching.topic:
        conditions.append(matches_any(table.c.name, matching.topic))
    if matching.message_type:
        conditions.append(matches_any(table.c.message_type, matching.message_type))
    return conditions


def refuse_metadata(actor: Actor, expressions: Sequence[str]) -> None:
    """Raise InvalidQuery for conditions on metadata that this actor does not see."""
    for expression in [] if sees_whole_missions(actor) else expressions:
        raise InvalidQuery(expression=expression, reason=_HIDDEN)


def negation(conditions: Conditions) -> ColumnElement[bool]:
    """Return the negation of conditions, which is true where they are unknown, such as of a missing time."""
    return and_(true(), *conditions).is_not(true())


def project_conditions(matching: MissionFilter | FileFilter) -> Conditions:
    """Return the conditions of a filter on the project."""
    conditions: Conditions = []
    if matching.project is not None:
        conditions.append(matches_key(project.c.name_key, matching.project))
    if matching.project_id is not None:
        conditions.append(project.c.id == matching.project_id)
    return conditions + any_of(project, matching.projects)


def any_of(table: Table, refs: Sequence[str]) -> Conditions:
    """Return the condition that a project or mission is one of `refs`: names, globs or ids."""
    if not refs:
        return []
    named = (matches_key(table.c.name_key, ref) for ref in refs if not is_id(ref))
    return [or_(table.c.id.in_([uuid.UUID(ref) for ref in refs if is_id(ref)]), *named)]


def span_conditions(
    matching: MissionFilter | FileFilter, start: ColumnElement[int | None], end: ColumnElement[int | None]
) -> Conditions:
    """Return the conditions of a filter on the span from `start` to `end`, in ns."""
    conditions: Conditions = []
    if matching.recorded_after is not None:
        conditions.append(end >= nanoseconds(matching.recorded_after))
    if matching.recorded_before is not None:
        conditions.append(start <= nanoseconds(matching.recorded_before))
    return conditions


def _start_conditions(matching: FileFilter) -> Conditions:
    """Return the conditions on the start of a file that a span implies, as the index of times has it."""
    conditions: Conditions = []
    start = func.coalesce(file.c.start_ns, literal(NO_TIME, BigInteger))
    if matching.recorded_before is not None:
        conditions.append(start <= nanoseconds(matching.recorded_before))
    if matching.recorded_after is not None and (after_ns := nanoseconds(matching.recorded_after)) > 0:
        # At most the longest duration of all files earlier.
        lasted = cast(blob.c.end_ns, Numeric) - cast(blob.c.start_ns, Numeric)
        longest = select(func.max(lasted)).correlate(None).scalar_subquery()
        first = func.greatest(literal(after_ns, BigInteger) - func.coalesce(longest, 0), literal(NO_TIME, BigInteger))
        conditions.append(start >= cast(first, BigInteger))
    return conditions


def _blob_conditions(matching: FileFilter) -> Conditions:
    conditions: Conditions = []
    if matching.format:
        conditions.append(blob.c.format.in_(matching.format))
    if matching.state:
        conditions.append(blob.c.state.in_([state.value for state in matching.state]))
    if matching.content:
        conditions.append(blob.c.content.in_([content.value for content in matching.content]))
    if matching.problem:
        entry = func.jsonb_array_elements(blob.c.problems).table_valued("value")
        code = cast(entry.c.value, JSONB)["code"].astext
        conditions.append(exists().select_from(entry).where(matches_any(code, matching.problem)))
    if matching.min_size_bytes is not None:
        conditions.append(blob.c.size_bytes >= matching.min_size_bytes)
    if matching.max_size_bytes is not None:
        conditions.append(blob.c.size_bytes <= matching.max_size_bytes)
    duration_ns = blob.c.end_ns - blob.c.start_ns
    if matching.min_duration_ns is not None:
        conditions.append(duration_ns >= matching.min_duration_ns)
    if matching.max_duration_ns is not None:
        conditions.append(duration_ns <= matching.max_duration_ns)
    if matching.month:
        conditions.append(or_(*(_starts_in(month) for month in matching.month)))
    return conditions


def _starts_in(month: str) -> ColumnElement[bool]:
    first = datetime.datetime.fromisoformat(f"{month}-01").replace(tzinfo=datetime.timezone.utc)
    following = (first + datetime.timedelta(days=31)).replace(day=1)
    return and_(file.c.start_ns >= nanoseconds(first), file.c.start_ns < nanoseconds(following))


def _has_label(labels: Sequence[str]) -> ColumnElement[bool]:
    labels_of_file = type_coerce(file.c.labels, ARRAY(Text))
    any_of: ColumnElement[bool] = labels_of_file.overlap([normalize("NFC", label) for label in labels])
    return any_of


def metadata_condition(expression: str) -> ColumnElement[bool]:
    """Return the condition of a comparison.

    Raises:
        InvalidQuery: it is not a comparison, or its value cannot be compared that way.
    """
    comparison = WHERE_EXPRESSION.fullmatch(expression.strip())
    if comparison is None:
        reason = "it is not a comparison; write FIELD=VALUE, or one of != < <= > >= ~ between them"
        raise InvalidQuery(expression=expression, reason=reason)
    path = comparison["field"].split(".")
    if "" in path:
        raise InvalidQuery(expression=expression, reason="the field has an empty part; write it like site.latitude")
    value = comparison["value"].strip()
    operator = comparison["operator"]
    if operator == "~":
        return metadata_text(path).ilike(like_pattern(value), escape="\\")
    if operator in {"=", "!="}:
        equal = or_(*(_contains(path, candidate) for candidate in _interpretations(value)))
        return equal if operator == "=" else and_(_at(path).is_not(None), not_(equal))
    return _ordered(expression, path, operator, value)


def metadata_text(path: Sequence[str]) -> ColumnElement[str]:
    """Return a field of the mission's metadata as text, null where it has none."""
    return mission.c.metadata.op("#>>", return_type=Text())(_keys(path))


def metadata_key(path: Sequence[str]) -> ColumnElement[object]:
    """Return a field of the mission's metadata as a sort key, null where it has none.

    Text comes before numbers, numbers before booleans; lists and locations are ordered as text.
    """
    value = _at(path)
    kind = func.jsonb_typeof(value)
    text = func.to_jsonb(func.left(metadata_text(path), _KEY_CHARACTERS), type_=JSONB())
    key = case((kind.in_(["number", "boolean"]), value), (kind == "null", None), else_=text)
    return type_coerce(key, JSONB())


def _keys(path: Sequence[str]) -> ColumnElement[Sequence[str]]:
    return bindparam(None, list(path), type_=ARRAY(Text))


def _at(path: Sequence[str]) -> ColumnElement[object]:
    return mission.c.metadata.op("#>", return_type=JSONB())(_keys(path))


def _contains(path: Sequence[str], value: _Scalar | list[_Scalar]) -> ColumnElement[bool]:
    document: object = value
    for key in reversed(path):
        document = {key: document}
    return mission.c.metadata.contains(document)


def _interpretations(value: str) -> list[_Scalar | list[_Scalar]]:
    """Return the possible meanings of a value, alone and as an item of a list."""
    scalars = scalars_of(value)
    return [*scalars, *([scalar] for scalar in scalars)]


def scalars_of(value: str) -> list[_Scalar]:
    """Return what a value may mean: a text, and a number or boolean where it reads as one; in quotes only a text."""
    text = _unquoted(value)
    if text is not None:
        return [text]
    canonical = iso_text(value)
    return [
        value,
        *([canonical] if canonical else []),
        *([_number(value)] if _NUMBER.fullmatch(value) else []),
        *([value.lower() == "true"] if value.lower() in {"true", "false"} else []),
    ]


def _unquoted(value: str) -> str | None:
    quoted = len(value) > 1 and value.startswith('"') and value.endswith('"')
    return value[1:-1] if quoted else None


def _number(value: str) -> int | float:
    return int(value) if value.lstrip("+-").isdigit() else float(value)


def _ordered(expression: str, path: Sequence[str], operator: str, value: str) -> ColumnElement[bool]:
    kind = func.jsonb_typeof(_at(path))
    text = _unquoted(value)
    if text is None and _NUMBER.fullmatch(value):
        # jsonb orders numbers as numbers; nothing is cast, so a mission with text there is passed over, not an error.
        return and_(
            kind == "number", _at(path).op(operator, is_comparison=True)(bindparam(None, _number(value), JSONB))
        )
    if text is None and value.lower() in {"true", "false"}:
        raise InvalidQuery(expression=expression, reason="true and false have no order; use = or !=")
    compared = text if text is not None else iso_text(value) or value
    stored = func.coalesce(metadata_text(path), "").collate("C")
    return and_(kind == "string", stored.op(operator, is_comparison=True)(compared))
