"""Words as SQL: conditions that a file or mission contains a word in names, notes, metadata, paths, labels or topics.

Each of these columns has a trigram index. Names of projects, topics and message types are few: those that contain the
words are looked up once per search, and then compared by value.
"""

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

from sqlalchemy import (
    CTE,
    BigInteger,
    ColumnElement,
    CompoundSelect,
    Select,
    Table,
    Text,
    and_,
    any_,
    bindparam,
    cast,
    false,
    func,
    literal,
    or_,
    select,
    true,
    union_all,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONPATH

from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import ESCAPE, ArrayText, Connection, among_parameter
from kleinkram.server.filters.plan import SearchPlan, SearchWord
from kleinkram.server.tables import (
    MAX_STORED_TOPICS,
    file,
    mission,
    mission_topic,
    mission_topics,
    project,
    topic,
    topic_name,
)

Conditions = list[ColumnElement[bool]]
# The value of files without a time in the index of times.
NO_TIME = -(2**63)
# The most projects, topics and types that contain a word and are compared by value.
_MAX_NAMES = 500
# A word in one of so many sampled paths is not looked up to find out whether it occurs at all.
_SAMPLED_PATHS = 300
# Message types that are searched for a word; those after them in order are found only by `type:`.
_MAX_MESSAGE_TYPES = 5_000
# A word without three letters or digits in a row has no trigram to be looked up by.
_TRIGRAM = re.compile(r"[^\W_]{3}")


def has_index(word: str) -> bool:
    """Return whether the trigram indexes can look a word up."""
    return _TRIGRAM.search(word) is not None


def file_contains(
    actor: Actor, plan: SearchPlan, text: str, in_mission: "WordInMission | None" = None
) -> ColumnElement[bool]:
    """Return the condition that a file contains a word: its path, labels, topics, mission or project.

    `in_mission` holds what was evaluated once for all files of the mission.
    """
    word = plan.word(text)
    in_file = _path_or_label_contains(word)
    mission_conditions = _mission_conditions(actor, word) if in_mission is None else [in_mission.contains]
    in_topics = _topic_conditions(word, topic)
    if text == plan.leading_word:
        return file.c.id.in_(_look_up(in_file, mission_conditions, in_topics, plan_conditions(plan)))
    has_topic = or_(false(), *(blob_has_topic(condition) for condition in in_topics))
    # The cheapest condition first.
    return or_(
        *in_file,
        *mission_conditions,
        has_topic if in_mission is None else and_(in_mission.may_have_topic, has_topic),
    )


class WordInMission(NamedTuple):
    """Whether a mission itself contains a word, and whether a topic of one of its files may."""

    contains: ColumnElement[bool]
    may_have_topic: ColumnElement[bool]


def word_in_mission(actor: Actor, plan: SearchPlan, text: str) -> WordInMission:
    """Return both conditions, on `mission`."""
    its_topics = or_(false(), *_topic_conditions(plan.word(text), mission_topic))
    return WordInMission(mission_contains(actor, plan, text), mission_may_have_topic(its_topics))


def mission_may_have_topic(*conditions: ColumnElement[bool]) -> ColumnElement[bool]:
    """Return a condition on `mission` without which no file of it has a topic of which conditions hold.

    `conditions` are on `mission_topic`, the stored topics of each mission, where these are current and complete.
    """
    its_own = select(true()).where(mission_topic.c.mission_id == mission.c.id).correlate(mission)
    current = select(true()).where(
        mission_topics.c.mission_id == mission.c.id, mission_topics.c.revision == mission.c.files_revision
    )
    is_cut_off = row_exists(its_own.offset(MAX_STORED_TOPICS - 1))
    return or_(row_exists(its_own.where(*conditions)), ~row_exists(current.correlate(mission)), is_cut_off)


def plan_conditions(plan: SearchPlan) -> Conditions:
    """Return the conditions on `file` and its `mission` that a plan adds to its filter."""
    # On both sides of the join: PostgreSQL does not conclude one from the other, and would read all missions.
    ids = () if plan.mission_ids is None else (file.c.mission_id, mission.c.id)
    conditions = [column == any_(bindparam("visible_mission_ids", type_=ArrayText("UUID"))) for column in ids]
    if plan.has_time is None:
        return conditions
    if plan.has_time:
        return [*conditions, file.c.start_ns.is_not(None)]
    # As the index of times has it, so that only those are read.
    no_time = literal(NO_TIME, BigInteger)
    return [*conditions, func.coalesce(file.c.start_ns, no_time) == no_time]


def mission_contains(actor: Actor, plan: SearchPlan, text: str) -> ColumnElement[bool]:
    """Return the condition that a mission itself contains a word: its name or project's, its notes or metadata."""
    return or_(false(), *_mission_conditions(actor, plan.word(text)))


def path_condition(condition: ColumnElement[bool]) -> ColumnElement[bool]:
    """Return a condition on the path of a `file` as its two indexes have it: files with a time, and those without."""
    timed = file.c.start_ns.is_not(None)
    return or_(and_(timed, condition), and_(~timed, condition))


def blob_has_topic(*conditions: ColumnElement[bool]) -> ColumnElement[bool]:
    """Return the condition that one of the topics of each `file` satisfies conditions."""
    return row_exists(topics_of_blob().where(*conditions))


def topics_of_blob() -> Select[tuple[bool]]:
    """Return a row for each topic of each `file` of the statement around it."""
    return select(true()).where(topic.c.blob_id == file.c.blob_id).correlate(file)


def row_exists(rows: Select[tuple[bool]]) -> ColumnElement[bool]:
    """Return whether a correlated select has a row, looked up for each row around it.

    With EXISTS, PostgreSQL may turn it into a join and read all topics of a common name.
    """
    return func.coalesce(rows.limit(1).scalar_subquery(), false())


async def look_up_words(db: Connection, words: Sequence[str]) -> dict[str, SearchWord]:
    """Return each word with where it occurs among the names that are few. It says nothing of rights."""
    unique = [SearchWord(word, number) for number, word in enumerate(dict.fromkeys(words))]
    if not unique:
        return {}
    values = {name: value for word in unique for name, value in word.values().items()}
    row = (await db.execute(_names_of_words(len(unique), _MAX_NAMES + 1), values)).one()
    matches = {}
    for at, word in enumerate(unique):
        *names, sampled_paths = row[4 * at : 4 * at + 4]
        projects, topics, types = (None if len(listed) > _MAX_NAMES else listed for listed in names)
        matches[word.text] = SearchWord(word.text, at, projects, topics, types, sampled_paths)
    return matches


@cache
def _names_of_words(count: int, limit: int) -> Select[tuple[Sequence[Any], ...]]:
    columns: list[ColumnElement[Any]] = []
    for word in (SearchWord("", number) for number in range(count)):
        projects = select(project.c.id).where(key_contains(project.c.name_key, word))
        topics = select(topic_name.c.name).where(contains(topic_name.c.name, word))
        types = select(_MESSAGE_TYPES.c.message_type).where(contains(_MESSAGE_TYPES.c.message_type, word))
        columns += [func.array(names.limit(limit).scalar_subquery()) for names in (projects, topics, types)]
        paths = select(file.c.path_key).order_by(file.c.id).limit(_SAMPLED_PATHS).subquery()
        columns.append(select(func.count()).where(key_contains(paths.c.path_key, word)).scalar_subquery())
    return select(*columns)


def _look_up(
    in_file: Conditions, in_mission: Conditions, in_topics: Conditions, of_all: Conditions
) -> CompoundSelect[tuple[object]]:
    """Return the ids of all files that satisfy one of the conditions, each looked up in its own index."""
    by_mission = select(file.c.id).join(mission, mission.c.id == file.c.mission_id)
    by_topic = select(file.c.id).join(topic, topic.c.blob_id == file.c.blob_id)
    lookups = [select(file.c.id).where(condition) for condition in in_file]
    lookups += [by_mission.where(or_(*in_mission))] if in_mission else []
    lookups += [by_topic.where(condition) for condition in in_topics]
    return union_all(*(condition.where(*of_all).correlate(None) for condition in lookups))


async def occur_somewhere(db: Connection, words: Iterable[SearchWord]) -> bool:
    """Return False if one of the words occurs in no file or mission at all, whatever the actor sees.

    Only words are looked up that have an index and are in no name of a project, topic or type, and in no sampled path.
    """
    rare = [
        word.text
        for word in words
        if not (word.sampled_paths or word.is_escaped_in_json or word.project_ids or word.topics or word.message_types)
        and None not in (word.project_ids, word.topics, word.message_types)
        and has_index(word.text)
    ]
    if not rare:
        return True
    values = {name: value for at, text in enumerate(rare) for name, value in SearchWord(text, at).values().items()}
    return all((await db.execute(_occurrences(len(rare)), values)).one())


@cache
def _occurrences(count: int) -> Select[tuple[bool, ...]]:
    columns = []
    for number in range(count):
        word = SearchWord("", number, project_ids=[])
        # Planned as if all rows were read, but read lazily: with a limit here, PostgreSQL would read the table until a
        # row matches, and all of it where none does.
        files = select(file.c.id).where(or_(*_path_or_label_contains(word))).cte(f"files_{number}")
        missions = select(mission.c.id).where(or_(*_whole_mission_conditions(word))).cte(f"missions_{number}")
        ids = (select(rows.prefix_with("MATERIALIZED").c.id) for rows in (files, missions))
        columns.append(or_(*(one.limit(1).scalar_subquery().is_not(None) for one in ids)))
    return select(*columns)


def contains(column: ColumnElement[str], word: SearchWord) -> ColumnElement[bool]:
    """Return the condition that a text contains a word, in any case."""
    return column.ilike(word.pattern, escape=ESCAPE)


def key_contains(column: ColumnElement[str], word: SearchWord) -> ColumnElement[bool]:
    """Return the condition that a column of name keys contains a word, in any case and Unicode form."""
    return column.like(word.key_pattern, escape=ESCAPE)


def _mission_conditions(actor: Actor, word: SearchWord) -> Conditions:
    # Conditions on the mission's own columns only, so that their indexes can be combined.
    if word.project_ids is None:
        named = select(project.c.id).where(key_contains(project.c.name_key, word)).correlate(None)
        in_project: Conditions = [mission.c.project_id == any_(func.array(named.scalar_subquery()))]
    else:
        in_project = [among_parameter(mission.c.project_id, word.name_of("project_ids"))] if word.project_ids else []
    if not sees_whole_missions(actor):
        return [key_contains(mission.c.name_key, word), *in_project]
    return [*_whole_mission_conditions(word), *in_project]


def _whole_mission_conditions(word: SearchWord) -> Conditions:
    in_name = key_contains(mission.c.name_key, word)
    return [in_name, contains(mission.c.notes, word), _metadata_contains(word)]


def _path_or_label_contains(word: SearchWord) -> Conditions:
    # Most files have no label: checking that first is faster.
    has_label = and_(func.cardinality(file.c.labels) > 0, contains(func.joined(file.c.labels), word))
    return [path_condition(key_contains(file.c.path_key, word)), has_label]


def _metadata_contains(word: SearchWord) -> ColumnElement[bool]:
    values = func.jsonb_path_query(mission.c.metadata, cast("strict $.**", JSONPATH))
    entry = values.table_valued("value").render_derived(name="metadata_value")
    as_text = entry.c.value.op("#>>", return_type=Text())(bindparam(None, [], ARRAY(Text)))
    scalar = func.jsonb_typeof(entry.c.value).not_in(["object", "array"])
    in_values: ColumnElement[bool] = select(entry.c.value).where(contains(as_text, word), scalar).exists()
    if word.is_escaped_in_json:
        return in_values
    # The text of all metadata has an index, but it contains the names of fields too.
    return and_(contains(cast(mission.c.metadata, Text), word), in_values)


def _topic_conditions(word: SearchWord, table: Table) -> Conditions:
    every_type = _MESSAGE_TYPES.c.message_type
    return [
        *_is_one_of(table.c.name, word, "topics", topic_name.c.name),
        *_is_one_of(table.c.message_type, word, "message_types", every_type),
    ]


def _is_one_of(column: ColumnElement[str], word: SearchWord, name: str, every: ColumnElement[str]) -> Conditions:
    names = getattr(word, name)
    if names is not None:
        return [among_parameter(column, word.name_of(name))] if names else []
    named = select(every).where(contains(every, word)).correlate(None)
    return [column == any_(func.array(named.scalar_subquery()))]


def _message_types() -> CTE:
    """Return the distinct message types by one index probe for each: `DISTINCT` would read every topic."""
    first = select(func.min(topic.c.message_type).label("message_type"))
    types = first.cte("message_types", recursive=True)
    following = select(func.min(topic.c.message_type)).where(topic.c.message_type > types.c.message_type)
    next_type = select(following.correlate(types).scalar_subquery()).where(types.c.message_type.is_not(None))
    return types.union_all(next_type.limit(_MAX_MESSAGE_TYPES))


_MESSAGE_TYPES = _message_types()
