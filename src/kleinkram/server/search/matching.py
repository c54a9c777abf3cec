"""What the filters of the contract mean: selects that began with `visible_*`, narrowed."""

import datetime
from collections.abc import Callable, Sequence
from typing import Any
from unicodedata import normalize

from sqlalchemy import (
    ColumnElement,
    FromClause,
    Integer,
    Select,
    Text,
    and_,
    bindparam,
    case,
    cast,
    func,
    literal,
    or_,
    select,
    true,
    type_coerce,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONPATH

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter
from kleinkram.contract.missions import MissionFilter
from kleinkram.contract.names import name_key
from kleinkram.contract.query.parsing import parse_term
from kleinkram.contract.query.words import phrases
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions, shown_files, shown_span, visible_files
from kleinkram.server.dates import nanoseconds
from kleinkram.server.search.globs import holds_word, key_holds_word, matches_any, matches_key
from kleinkram.server.search.where import condition
from kleinkram.server.tables import blob, file, mission, project, topic

Conditions = list[ColumnElement[bool]]
# What a filter of files says that can be said of a mission itself.
_SAID_OF_MISSIONS = frozenset(
    {
        *("text", "project", "project_id", "mission", "mission_id", "where", "recorded_after", "recorded_before"),
        "without",
    }
)
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
    conditions += [condition(expression) for expression in matching.where]
    conditions += _words(matching.text, _mission_holds if sees_whole_missions(actor) else _mission_is_named)
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
    return stmt.where(*_of_files(actor, matching))


def narrow_missions_found(actor: Actor, stmt: Select[Any], matching: FileFilter) -> Select[Any]:
    """Return the missions of a select that a filter of files finds: by what they say themselves, or by their files.

    Raises:
        InvalidQuery: a `where` cannot be used.
    """
    if matching == FileFilter():
        return stmt
    files = narrow_files(actor, visible_files(actor), matching)
    by_files = mission.c.id.in_(files.with_only_columns(file.c.mission_id, maintain_column_froms=True).correlate(None))
    return stmt.where(
        or_(by_files, and_(true(), *_of_missions(actor, matching))) if _says_of_missions(matching) else by_files
    )


def narrow_topics(stmt: Select[Any], matching: FileFilter) -> Select[Any]:
    """Return the topics of a select joined with them that match the filter's topics and message types."""
    return stmt.where(*_topic_conditions(matching))


def words_in(column: ColumnElement[str], matching: FileFilter) -> ColumnElement[int]:
    """Return how many of the words of a filter a text holds."""
    held = [case((holds_word(column, word), 1), else_=0) for word in phrases(matching.text or "")]
    return sum(held, literal(0, Integer))


def _of_files(actor: Actor, matching: FileFilter) -> Conditions:
    _refuse_metadata(actor, matching)
    conditions = _place(matching) + _span(matching, blob.c.start_ns, blob.c.end_ns) + _bytes(matching)
    if matching.mission is not None:
        conditions.append(matches_key(mission.c.name_key, matching.mission))
    if matching.mission_id is not None:
        conditions.append(mission.c.id == matching.mission_id)
    if matching.recording_id is not None:
        conditions.append(file.c.recording_id == matching.recording_id)
    if matching.path:
        conditions.append(matches_any(file.c.path_key, [name_key(glob) for glob in matching.path]))
    if matching.label:
        conditions.append(_labelled(matching.label))
    conditions += [condition(expression) for expression in matching.where]
    in_mission = _mission_holds if sees_whole_missions(actor) else _mission_is_named
    conditions += _words(matching.text, lambda word: or_(_its_mission(in_mission, word), *_file_holds(word)))
    if matching.topic or matching.message_type:
        conditions.append(_blob_has_topic(*_topic_conditions(matching)))
    return conditions + [_fails(_of_files(actor, parse_term(term))) for term in matching.without]


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
    return conditions


def _span(
    matching: MissionFilter | FileFilter, start: ColumnElement[int | None], end: ColumnElement[int | None]
) -> Conditions:
    conditions: Conditions = []
    if matching.recorded_after is not None:
        conditions.append(end >= nanoseconds(matching.recorded_after))
    if matching.recorded_before is not None:
        conditions.append(start <= nanoseconds(matching.recorded_before))
    return conditions


def _bytes(matching: FileFilter) -> Conditions:
    conditions: Conditions = []
    if matching.format:
        conditions.append(blob.c.format.in_(matching.format))
    if matching.state:
        conditions.append(blob.c.state.in_([state.value for state in matching.state]))
    if matching.content:
        conditions.append(blob.c.content.in_([content.value for content in matching.content]))
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
    return and_(blob.c.start_ns >= nanoseconds(first), blob.c.start_ns < nanoseconds(following))


def _topic_conditions(matching: MissionFilter | FileFilter) -> Conditions:
    conditions: Conditions = []
    if matching.topic:
        conditions.append(matches_any(topic.c.name, matching.topic))
    if matching.message_type:
        conditions.append(matches_any(topic.c.message_type, matching.message_type))
    return conditions


def _labelled(labels: Sequence[str]) -> ColumnElement[bool]:
    held = type_coerce(file.c.labels, ARRAY(Text))
    any_of: ColumnElement[bool] = held.overlap([normalize("NFC", label) for label in labels])
    return any_of


def _blob_has_topic(*conditions: ColumnElement[bool]) -> ColumnElement[bool]:
    # Its own look at the topics, even where the statement around it lists topics too.
    return select(topic.c.id).where(topic.c.blob_id == file.c.blob_id, *conditions).correlate(file).exists()


def _mission_has_topic(conditions: Sequence[ColumnElement[bool]]) -> ColumnElement[bool]:
    its_topics = select(file.c.id).join(topic, topic.c.blob_id == file.c.blob_id)
    return (
        its_topics.where(file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None), and_(*conditions))
        .correlate(mission)
        .exists()
    )


def _words(text: str | None, holds: Callable[[str], ColumnElement[bool]]) -> Conditions:
    return [holds(word) for word in phrases(text or "")]


def _refuse_metadata(actor: Actor, matching: MissionFilter | FileFilter) -> None:
    if sees_whole_missions(actor):
        return
    satisfied = isinstance(matching, MissionFilter) and matching.satisfied is not None
    for expression in [*matching.where, *(["satisfied"] if satisfied else [])]:
        raise InvalidQuery(expression=expression, reason=_UNSEEN)


def _project_is_named(word: str) -> ColumnElement[bool]:
    return key_holds_word(project.c.name_key, word)


def _mission_is_named(word: str, of: FromClause = mission, within: FromClause = project) -> ColumnElement[bool]:
    return or_(key_holds_word(of.c.name_key, word), key_holds_word(within.c.name_key, word))


def _project_holds(word: str) -> ColumnElement[bool]:
    return or_(_project_is_named(word), holds_word(project.c.description, word))


def _mission_holds(word: str, of: FromClause = mission, within: FromClause = project) -> ColumnElement[bool]:
    values = func.jsonb_path_query(of.c.metadata, cast("strict $.**", JSONPATH)).table_valued("value").render_derived()
    as_text = values.c.value.op("#>>", return_type=Text())(bindparam(None, [], ARRAY(Text)))
    in_values = select(values.c.value).where(holds_word(as_text, word))
    scalar = func.jsonb_typeof(values.c.value).not_in(["object", "array"])
    return or_(
        _mission_is_named(word, of, within),
        holds_word(of.c.notes, word),
        in_values.where(scalar).exists(),
    )


def _its_mission(holds: Callable[[str, FromClause, FromClause], ColumnElement[bool]], word: str) -> ColumnElement[bool]:
    # Asked of nothing outside: each mission is looked at once, not once for each of its files.
    of, within = mission.alias("its_mission"), project.alias("its_project")
    found = select(of.c.id).join(within, within.c.id == of.c.project_id).where(holds(word, of, within))
    return file.c.mission_id.in_(found)


def _file_holds(word: str) -> Conditions:
    """Return where a file may hold a word, the cheapest to look at first."""
    labels = holds_word(func.array_to_string(file.c.labels, "\n"), word)
    return [key_holds_word(file.c.path_key, word), labels, _blob_has_topic(holds_word(topic.c.name, word))]
