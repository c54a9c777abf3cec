"""What the filters of the contract mean: selects that began with `visible_*`, narrowed."""

import datetime
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any
from unicodedata import normalize

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Integer,
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
    func,
    literal,
    or_,
    select,
    true,
    type_coerce,
    union_all,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONB

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter
from kleinkram.contract.missions import MissionFilter
from kleinkram.contract.names import is_id
from kleinkram.contract.query.parsing import parse_term
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.looked import Found
from kleinkram.server.access.visible import sees_whole_missions, shown_files, shown_span, visible_files
from kleinkram.server.dates import nanoseconds
from kleinkram.server.db import Written
from kleinkram.server.filters.kept import is_there, may_have_topic, where_it_may_be
from kleinkram.server.filters.metadata import condition
from kleinkram.server.filters.patterns import holds_word, key_holds_word, matches_any, matches_key
from kleinkram.server.filters.text import (
    blob_has_topic,
    file_holds,
    holds,
    is_named,
    mission_holds,
    mission_may_hold,
    of_paths,
    words_of,
)
from kleinkram.server.tables import blob, file, mission, mission_topic, project, topic

Conditions = list[ColumnElement[bool]]
# What a filter of files says that can be said of a mission itself.
_SAID_OF_MISSIONS = frozenset(
    {
        *("text", "project", "project_id", "projects", "mission", "mission_id", "missions"),
        *("where", "recorded_after", "recorded_before"),
        "without",
    }
)
# Where files stand in the index of times that have none.
_NEVER = -(2**63)
_UNSEEN = "what you came with does not show metadata of missions"


def narrow_projects(actor: Actor, stmt: Select[Any], *, name: str | None, text: str | None) -> Select[Any]:
    """Return the projects of a select that match; `text` is found in names and descriptions, word by word."""
    conditions = [matches_key(project.c.name_key, name)] if name is not None else []
    return stmt.where(*conditions, *_words(text, _project_holds if sees_whole_missions(actor) else _project_is_named))


def narrow_missions(actor: Actor, stmt: Select[Any], matching: MissionFilter) -> Select[Any]:
    """Return the missions of a select that match.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    _refuse_metadata(actor, matching)
    return stmt.where(*_conditions(actor, matching))


def _conditions(actor: Actor, matching: MissionFilter) -> Conditions:
    conditions = _place(matching) + _span(matching, *shown_span(actor))
    if matching.name is not None:
        conditions.append(matches_key(mission.c.name_key, matching.name))
    conditions += _any_of(mission, matching.missions)
    conditions += [condition(expression) for expression in matching.where]
    conditions += _words(matching.text, lambda word: mission_holds(actor, word))
    if matching.topic or matching.message_type:
        conditions.append(_mission_has_topic([shown_files(actor), *_topic_conditions(matching)]))
    if matching.completed is not None:
        conditions.append(mission.c.completed_at.is_not(None) == matching.completed)
    if matching.satisfied is not None:
        conditions.append((func.jsonb_array_length(mission.c.metadata_problems) == 0) == matching.satisfied)
    return conditions


def narrow_files(actor: Actor, stmt: Select[Any], matching: FileFilter) -> Select[Any]:
    """Return the files of a select that match.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    return stmt.where(*file_conditions(actor, matching))


def narrow_walked(actor: Actor, stmt: Select[Any], matching: FileFilter) -> Select[Any]:
    """Return the files of a select that match, to be walked in their order until enough are met.

    What is asked of their missions is asked once of each, and not with each of its files: there may be thousands.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    words, may_hold = [*dict.fromkeys(words_of(matching.text))], _may_hold(actor, matching)
    if not may_hold and all(is_named(actor, word) for word in words):
        return narrow_files(actor, stmt, matching)
    said = [mission_holds(actor, word).label(f"holds_{number}") for number, word in enumerate(words)]
    asked = select(and_(true(), *may_hold).label("may_hold"), *said)
    # Behind a fence, and joined from outside: nothing of the file is asked with it, so the database keeps the answer.
    around = asked.where(mission.c.id == file.c.mission_id).correlate(file).offset(0).lateral("around")
    in_mission = dict(zip(words, (around.c[each.name] for each in said), strict=True))
    held = where_it_may_be([around.c.may_hold], and_(true(), *_held_conditions(actor, matching, in_mission)))
    return stmt.outerjoin(around, true()).where(*_own_conditions(actor, matching), held)


def narrow_missions_found(actor: Actor, stmt: Select[Any], matching: FileFilter) -> Select[Any]:
    """Return the missions of a select that a filter of files finds: by what they say themselves, or by their files.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    if matching == FileFilter():
        return stmt
    by_files = _by_files(actor, matching)
    if not _says_of_missions(matching):
        return stmt.where(mission.c.id.in_(by_files) if isinstance(by_files, Select) else by_files)
    own = _of_missions(actor, matching)
    if not isinstance(by_files, Select):
        return stmt.where(or_(by_files, and_(true(), *own)))
    # Each looked up by itself: with OR, every mission there is would be looked at.
    by_itself = select(mission.c.id).join(project, project.c.id == mission.c.project_id).where(*own)
    return stmt.where(mission.c.id.in_(union_all(by_files, by_itself.correlate(None))))


def _by_files(actor: Actor, matching: FileFilter) -> Select[Any] | ColumnElement[bool]:
    if actor.looked.found is not None:
        return select(func.unnest(_found(actor.looked.found, "mission_ids")))
    if not actor.looked.finds_many:
        files = narrow_files(actor, visible_files(actor), matching)
        return files.with_only_columns(file.c.mission_id, maintain_column_froms=True).correlate(None)
    # Most missions have some: one is soon met. The mission around it is visible, so only its files are asked about.
    inside = select(file.c.id).outerjoin(blob, blob.c.id == file.c.blob_id)
    live = (file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None), shown_files(actor))
    each = replace(actor, looked=replace(actor.looked, asks_missions=True))
    files = inside.where(*live, *file_conditions(each, matching)).correlate(mission, project)
    # Mission by mission: as EXISTS, the database may well look up all files that match, of all missions.
    return where_it_may_be(_may_hold(actor, matching), is_there(files.with_only_columns(true())))


def _may_hold(actor: Actor, matching: FileFilter) -> Conditions:
    """Return conditions on a mission, quickly looked at, without which no file of it matches."""
    words = (mission_may_hold(actor, word) for word in words_of(matching.text))
    conditions = [each for each in words if each is not None]
    if matching.topic or matching.message_type:
        conditions.append(may_have_topic(*_topic_conditions(matching, mission_topic)))
    return conditions


def narrow_topics(stmt: Select[Any], matching: FileFilter) -> Select[Any]:
    """Return the topics of a select joined with them that match the filter's topics and message types."""
    return stmt.where(*_topic_conditions(matching))


def words_in(actor: Actor, column: ColumnElement[str], matching: FileFilter) -> ColumnElement[int]:
    """Return how many of the words of a filter a text holds."""
    held = [case((holds(column, actor.looked.of(word)), 1), else_=0) for word in words_of(matching.text)]
    return sum(held, literal(0, Integer))


def file_conditions(actor: Actor, matching: FileFilter) -> Conditions:
    """Return what must hold of `file`, `mission`, `project` and `blob` for a filter of files.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    if actor.looked.found is not None:
        return [file.c.id == any_(_found(actor.looked.found, "file_ids"))]
    return _own_conditions(actor, matching) + _held_conditions(actor, matching)


def _own_conditions(actor: Actor, matching: FileFilter) -> Conditions:
    """Return all that a filter says but for words and topics."""
    _refuse_metadata(actor, matching)
    conditions = _place(matching) + _span(matching, file.c.start_ns, blob.c.end_ns) + _begun(matching)
    conditions += _bytes(matching)
    if matching.mission is not None:
        conditions.append(matches_key(mission.c.name_key, matching.mission))
    if matching.mission_id is not None:
        conditions.append(mission.c.id == matching.mission_id)
    conditions += _any_of(mission, matching.missions)
    if matching.recording_id is not None:
        conditions.append(file.c.recording_id == matching.recording_id)
    if matching.path:
        conditions.append(or_(*(of_paths(matches_key(file.c.path_key, glob)) for glob in matching.path)))
    if matching.label:
        conditions.append(_labelled(matching.label))
    conditions += [condition(expression) for expression in matching.where]
    return conditions + [_fails(file_conditions(actor, parse_term(term))) for term in matching.without]


def _held_conditions(
    actor: Actor, matching: FileFilter, in_mission: Mapping[str, ColumnElement[bool]] | None = None
) -> Conditions:
    """Return what a filter says of words and topics; in a walk, `in_mission` says which words the mission holds."""
    held = {} if in_mission is None else in_mission
    conditions = _words(matching.text, lambda word: file_holds(actor, word, held.get(word)))
    if matching.topic or matching.message_type:
        conditions.append(blob_has_topic(*_topic_conditions(matching), one_by_one=in_mission is not None))
    return conditions


def _found(found: Found, what: str) -> ColumnElement[Any]:
    kind = Written("UUID")
    return bindparam(f"found_{what}", type_=kind) if found.is_general else literal(getattr(found, what), kind)


def _of_missions(actor: Actor, matching: FileFilter) -> Conditions:
    """Return the conditions of a filter that says nothing of files, on missions."""
    own = MissionFilter(
        **{name: getattr(matching, name) for name in _SAID_OF_MISSIONS if name in MissionFilter.model_fields},
        name=matching.mission,
    )
    _refuse_metadata(actor, own)
    conditions = _conditions(actor, own)
    if matching.mission_id is not None:
        conditions.append(mission.c.id == matching.mission_id)
    return conditions + [_fails(_of_missions(actor, parse_term(term))) for term in matching.without]


def _says_of_missions(matching: FileFilter) -> bool:
    """Say whether all that a filter says can be said of a mission itself."""
    others = matching.model_dump(exclude_defaults=True).keys() - _SAID_OF_MISSIONS
    return not others and all(_says_of_missions(parse_term(term)) for term in matching.without)


def _fails(conditions: Conditions) -> ColumnElement[bool]:
    # What cannot be said of something, such as when a file without times was recorded, does not hold of it.
    return and_(true(), *conditions).is_not(true())


def _place(matching: MissionFilter | FileFilter) -> Conditions:
    conditions: Conditions = []
    if matching.project is not None:
        conditions.append(matches_key(project.c.name_key, matching.project))
    if matching.project_id is not None:
        conditions.append(project.c.id == matching.project_id)
    return conditions + _any_of(project, matching.projects)


def _any_of(table: Table, refs: Sequence[str]) -> Conditions:
    """Return the condition that a project or mission is one of those that are meant: by name, glob or id."""
    if not refs:
        return []
    named = (matches_key(table.c.name_key, ref) for ref in refs if not is_id(ref))
    return [or_(table.c.id.in_([uuid.UUID(ref) for ref in refs if is_id(ref)]), *named)]


def _span(
    matching: MissionFilter | FileFilter, start: ColumnElement[int | None], end: ColumnElement[int | None]
) -> Conditions:
    conditions: Conditions = []
    if matching.recorded_after is not None:
        conditions.append(end >= nanoseconds(matching.recorded_after))
    if matching.recorded_before is not None:
        conditions.append(start <= nanoseconds(matching.recorded_before))
    return conditions


def _begun(matching: FileFilter) -> Conditions:
    """Return what follows of a span for when a file begins, said as the index of that has it."""
    conditions: Conditions = []
    begun = func.coalesce(file.c.start_ns, literal(_NEVER, BigInteger))
    if matching.recorded_before is not None:
        conditions.append(begun <= nanoseconds(matching.recorded_before))
    if matching.recorded_after is not None and (after_ns := nanoseconds(matching.recorded_after)) > 0:
        # Not longer before than the longest of all files lasts.
        lasted = cast(blob.c.end_ns, Numeric) - cast(blob.c.start_ns, Numeric)
        longest = select(func.max(lasted)).correlate(None).scalar_subquery()
        first = func.greatest(literal(after_ns, BigInteger) - func.coalesce(longest, 0), literal(_NEVER, BigInteger))
        conditions.append(begun >= cast(first, BigInteger))
    return conditions


def _bytes(matching: FileFilter) -> Conditions:
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
        conditions.append(or_(*(_began_in(month) for month in matching.month)))
    return conditions


def _began_in(month: str) -> ColumnElement[bool]:
    first = datetime.datetime.fromisoformat(f"{month}-01").replace(tzinfo=datetime.timezone.utc)
    following = (first + datetime.timedelta(days=31)).replace(day=1)
    return and_(file.c.start_ns >= nanoseconds(first), file.c.start_ns < nanoseconds(following))


def _topic_conditions(matching: MissionFilter | FileFilter, table: Table = topic) -> Conditions:
    conditions: Conditions = []
    if matching.topic:
        conditions.append(matches_any(table.c.name, matching.topic))
    if matching.message_type:
        conditions.append(matches_any(table.c.message_type, matching.message_type))
    return conditions


def _labelled(labels: Sequence[str]) -> ColumnElement[bool]:
    held = type_coerce(file.c.labels, ARRAY(Text))
    any_of: ColumnElement[bool] = held.overlap([normalize("NFC", label) for label in labels])
    return any_of


def _mission_has_topic(conditions: Sequence[ColumnElement[bool]]) -> ColumnElement[bool]:
    its_topics = select(file.c.id).join(topic, topic.c.blob_id == file.c.blob_id)
    return (
        its_topics.where(file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None), and_(*conditions))
        .correlate(mission)
        .exists()
    )


def _words(text: str | None, holds: Callable[[str], ColumnElement[bool]]) -> Conditions:
    return [holds(word) for word in words_of(text)]


def _refuse_metadata(actor: Actor, matching: MissionFilter | FileFilter) -> None:
    if sees_whole_missions(actor):
        return
    satisfied = isinstance(matching, MissionFilter) and matching.satisfied is not None
    for expression in [*matching.where, *(["satisfied"] if satisfied else [])]:
        raise InvalidQuery(expression=expression, reason=_UNSEEN)


def _project_is_named(word: str) -> ColumnElement[bool]:
    return key_holds_word(project.c.name_key, word)


def _project_holds(word: str) -> ColumnElement[bool]:
    return or_(_project_is_named(word), holds_word(project.c.description, word))
