"""What it means that a file or a mission contains a word: in names, notes, metadata, paths, labels and topics.

Each place has a trigram index of its own. Names of projects, topics and message types are few: they are looked up once
for a search, and then compared by value.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

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

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.query import phrases
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection, among
from kleinkram.server.filters.patterns import holds_word, key_holds_word
from kleinkram.server.filters.plan import SearchPlan, WordMatches
from kleinkram.server.tables import (
    MOST_KEPT_TOPICS,
    file,
    mission,
    mission_topic,
    mission_topics,
    project,
    topic,
    topic_name,
)

Conditions = list[ColumnElement[bool]]
# Where files without a time stand in the index of times.
NO_TIME = -(2**63)
# Each word is looked for in every place where one can occur.
MAX_WORDS = 20
# So many projects, topics and types that contain a word are listed by value.
_MAX_NAMES = 500
# Message types that are searched for a word; those after them in order are found by `type:` alone.
_MAX_MESSAGE_TYPES = 5_000
# A word without three letters or digits in a row has no trigram to be looked up by.
_TRIGRAM = re.compile(r"[^\W_]{3}")
# Characters that JSON writes differently.
_ESCAPED_IN_JSON = re.compile(r'["\\\x00-\x1f\x7f]')


def words_of(text: str | None) -> list[str]:
    """Return the words of the `text` of a filter.

    Raises:
        InvalidQuery: there are more than `MAX_WORDS`.
    """
    words = phrases(text or "")
    if len(words) > MAX_WORDS:
        reason = f"a search has at most {MAX_WORDS} words; put words that belong together in quotes"
        raise InvalidQuery(expression=words[MAX_WORDS], reason=reason)
    return words


def has_index(word: str) -> bool:
    """Return whether the trigram indexes can look a word up."""
    return _TRIGRAM.search(word) is not None


def file_contains(
    actor: Actor, plan: SearchPlan, word: str, of_mission: "WordInMission | None" = None
) -> ColumnElement[bool]:
    """Return the condition that a file contains a word: its path, labels, topics, mission or project.

    `of_mission` holds what was evaluated once for all files of the mission.
    """
    matches = plan.matches_of(word)
    in_mission = _mission_contains(actor, word, matches) if of_mission is None else [of_mission.contains]
    in_file, in_topics = _path_or_label_contains(word), _topic_contains(word, matches, topic)
    if word == plan.leading_word:
        return file.c.id.in_(_look_up(in_file, in_mission, in_topics, plan_conditions(plan)))
    has_topic = or_(false(), *(blob_has_topic(each) for each in in_topics))
    # The cheapest condition first.
    return or_(*in_file, *in_mission, has_topic if of_mission is None else and_(of_mission.may_have_topic, has_topic))


class WordInMission(NamedTuple):
    """Whether a mission itself contains a word, and whether a topic of one of its files may."""

    contains: ColumnElement[bool]
    may_have_topic: ColumnElement[bool]


def word_in_mission(actor: Actor, plan: SearchPlan, word: str) -> WordInMission:
    """Return both conditions on `mission`."""
    its_topics = or_(false(), *_topic_contains(word, plan.matches_of(word), mission_topic))
    return WordInMission(mission_contains(actor, plan, word), mission_may_have_topic(its_topics))


def mission_may_have_topic(*conditions: ColumnElement[bool]) -> ColumnElement[bool]:
    """Return a condition on `mission` without which no file of it has a topic of which conditions hold.

    `conditions` are on `mission_topic`, the topics kept of each mission; they decide where these are current and whole.
    """
    its_own = select(true()).where(mission_topic.c.mission_id == mission.c.id).correlate(mission)
    current = select(true()).where(
        mission_topics.c.mission_id == mission.c.id, mission_topics.c.revision == mission.c.files_revision
    )
    is_cut_off = row_exists(its_own.offset(MOST_KEPT_TOPICS - 1))
    return or_(row_exists(its_own.where(*conditions)), ~row_exists(current.correlate(mission)), is_cut_off)


def plan_conditions(plan: SearchPlan) -> Conditions:
    """Return the conditions on files that a plan adds to its filter."""
    conditions = [] if plan.mission_ids is None else [among(file.c.mission_id, plan.mission_ids)]
    if plan.has_time is None:
        return conditions
    if plan.has_time:
        return [*conditions, file.c.start_ns.is_not(None)]
    # As the index of times has it, so that only those are read.
    no_time = literal(NO_TIME, BigInteger)
    return [*conditions, func.coalesce(file.c.start_ns, no_time) == no_time]


def mission_contains(actor: Actor, plan: SearchPlan, word: str) -> ColumnElement[bool]:
    """Return the condition that a mission itself contains a word: its name or project's, its notes or metadata."""
    return or_(false(), *_mission_contains(actor, word, plan.matches_of(word)))


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


def row_exists(found: Select[tuple[bool]]) -> ColumnElement[bool]:
    """Return whether a correlated select has a row, looked up for each row around it.

    With EXISTS, PostgreSQL may turn it into a join and read all topics of a common name.
    """
    return func.coalesce(found.limit(1).scalar_subquery(), false())


async def look_up_words(db: Connection, words: Sequence[str]) -> dict[str, WordMatches]:
    """Return where each word occurs among the names that are few. It says nothing of rights."""
    unique = [*dict.fromkeys(words)]
    if not unique:
        return {}
    columns = []
    for word in unique:
        projects = select(project.c.id).where(key_holds_word(project.c.name_key, word))
        topics = select(topic_name.c.name).where(holds_word(topic_name.c.name, word))
        types = select(_MESSAGE_TYPES.c.message_type).where(holds_word(_MESSAGE_TYPES.c.message_type, word))
        columns += [func.array(each.limit(_MAX_NAMES + 1).scalar_subquery()) for each in (projects, topics, types)]
    row = (await db.execute(select(*columns))).one()
    listed = [None if len(values) > _MAX_NAMES else values for values in row]
    return {word: WordMatches(*listed[3 * at : 3 * at + 3]) for at, word in enumerate(unique)}


def _look_up(
    in_file: Conditions, in_mission: Conditions, in_topics: Conditions, of_all: Conditions
) -> CompoundSelect[tuple[object]]:
    """Return the ids of all files of which one condition holds, each looked up in an index of its own."""
    by_mission = select(file.c.id).join(mission, mission.c.id == file.c.mission_id)
    by_topic = select(file.c.id).join(topic, topic.c.blob_id == file.c.blob_id)
    found = [select(file.c.id).where(each) for each in in_file]
    found += [by_mission.where(or_(*in_mission))] if in_mission else []
    found += [by_topic.where(each) for each in in_topics]
    return union_all(*(each.where(*of_all).correlate(None) for each in found))


def _path_or_label_contains(word: str) -> Conditions:
    # Most files have no label: to see that is quicker than to join none.
    has_label = and_(func.cardinality(file.c.labels) > 0, holds_word(func.joined(file.c.labels), word))
    return [path_condition(key_holds_word(file.c.path_key, word)), has_label]


def _mission_contains(actor: Actor, word: str, matches: WordMatches) -> Conditions:
    # Conditions on the mission's own columns only, so that their indexes can be combined.
    if matches.project_ids is None:
        named = select(project.c.id).where(key_holds_word(project.c.name_key, word)).correlate(None)
        in_project: Conditions = [mission.c.project_id == any_(func.array(named.scalar_subquery()))]
    else:
        in_project = [among(mission.c.project_id, matches.project_ids)] if matches.project_ids else []
    in_name = key_holds_word(mission.c.name_key, word)
    if not sees_whole_missions(actor):
        return [in_name, *in_project]
    return [in_name, holds_word(mission.c.notes, word), _metadata_contains(word), *in_project]


def _metadata_contains(word: str) -> ColumnElement[bool]:
    values = func.jsonb_path_query(mission.c.metadata, cast("strict $.**", JSONPATH))
    each = values.table_valued("value").render_derived(name="each_value")
    as_text = each.c.value.op("#>>", return_type=Text())(bindparam(None, [], ARRAY(Text)))
    scalar = func.jsonb_typeof(each.c.value).not_in(["object", "array"])
    in_values: ColumnElement[bool] = select(each.c.value).where(holds_word(as_text, word), scalar).exists()
    if _ESCAPED_IN_JSON.search(word):
        return in_values
    # The whole as text has an index, and is quickly searched; but it contains the names of fields too.
    return and_(holds_word(cast(mission.c.metadata, Text), word), in_values)


def _topic_contains(word: str, matches: WordMatches, table: Table) -> Conditions:
    return [
        *_one_of(table.c.name, word, matches.topics, topic_name.c.name),
        *_one_of(table.c.message_type, word, matches.message_types, _MESSAGE_TYPES.c.message_type),
    ]


def _one_of(
    column: ColumnElement[str], word: str, values: Sequence[str] | None, every: ColumnElement[str]
) -> Conditions:
    if values is not None:
        return [among(column, values)] if values else []
    named = select(every).where(holds_word(every, word)).correlate(None)
    return [column == any_(func.array(named.scalar_subquery()))]


def _message_types() -> CTE:
    """Return all message types, each once, by one probe of their index for each: `DISTINCT` would read every topic."""
    first = select(func.min(topic.c.message_type).label("message_type"))
    types = first.cte("message_types", recursive=True)
    following = select(func.min(topic.c.message_type)).where(topic.c.message_type > types.c.message_type)
    each = select(following.correlate(types).scalar_subquery()).where(types.c.message_type.is_not(None))
    return types.union_all(each.limit(_MAX_MESSAGE_TYPES))


_MESSAGE_TYPES = _message_types()
