"""What it means that a file or a mission holds a word, and where the words of a search are said.

Each place has an index of its own: a word's places are looked up once, before the search, and where they are few they
are named. What is left to be asked of each row is then little, and nothing at all of a word that is nowhere.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

from sqlalchemy import (
    CTE,
    BindParameter,
    ColumnElement,
    CompoundSelect,
    Select,
    Subquery,
    Table,
    Text,
    and_,
    any_,
    bindparam,
    cast,
    false,
    func,
    or_,
    select,
    true,
    union_all,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONPATH
from sqlalchemy.types import TypeEngine

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.names import name_key
from kleinkram.contract.query.words import phrases
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.looked import NONE_AT_ALL, Said
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.access.whoever import KEPT
from kleinkram.server.db import Connection, Written
from kleinkram.server.filters.kept import is_there, may_have_topic
from kleinkram.server.filters.patterns import ESCAPE, containing
from kleinkram.server.tables import file, mission, mission_topic, project, topic, topic_name

Conditions = list[ColumnElement[bool]]
# Each is looked for in every place where a word can stand.
MOST_WORDS = 20
# Places of one kind that are named.
_MOST = 500
# Message types that are looked through for a word; those after them in order are found by `type:` alone.
_MOST_TYPES = 5_000
# Where of so many, drawn by lot, one in so many holds a word, its places are not looked up: there are very many.
_FILES_DRAWN, _MISSIONS_DRAWN, _COMMON = 300, 100, 50
# A word without three letters or digits on end has no trigram to be looked up by.
_LOOKED_UP = re.compile(r"[^\W_]{3}")
# What JSON writes otherwise than it is.
_ESCAPED_IN_JSON = re.compile(r'["\\\x00-\x1f\x7f]')


def words_of(text: str | None) -> list[str]:
    """Return the words of the `text` of a filter.

    Raises:
        InvalidQuery: there are more than `MOST_WORDS`.
    """
    words = phrases(text or "")
    if len(words) > MOST_WORDS:
        reason = f"a search has at most {MOST_WORDS} words; put those that stand side by side in quotes"
        raise InvalidQuery(expression=words[MOST_WORDS], reason=reason)
    return words


def has_index(word: str) -> bool:
    """Say whether the indexes can look a word up."""
    return _LOOKED_UP.search(word) is not None


def file_holds(actor: Actor, word: str, in_its_mission: ColumnElement[bool] | None = None) -> ColumnElement[bool]:
    """Return the condition that a file holds a word: in path or labels, topics and their types, its mission or project.

    In a walk, `in_its_mission` says whether the latter two hold it.
    """
    said = actor.looked.of(word)
    in_file = _in_file(said)
    in_mission = _in_mission(actor, said) if in_its_mission is None else [in_its_mission]
    in_topics = _in_topics(said)
    if in_mission and actor.looked.asks_missions:
        # Asked for once of the mission around, and not with each of its files.
        in_mission = [select(or_(*in_mission)).correlate(mission, project).scalar_subquery()]
    if word == actor.looked.led_by and (in_mission or in_topics):
        return file.c.id.in_(_looked_up(in_file, in_mission, in_topics))
    is_walked = in_its_mission is not None
    # As a join, all topics of a common name would be read.
    has_topic = [blob_has_topic(each, one_by_one=is_walked).is_(true()) for each in in_topics]
    # The cheapest to look at first.
    return or_(false(), *in_file, *in_mission, *has_topic)


def mission_holds(actor: Actor, word: str) -> ColumnElement[bool]:
    """Return the condition that a mission holds a word itself: in its name or project's, its notes or metadata."""
    return or_(false(), *_in_mission(actor, actor.looked.of(word)))


def is_named(actor: Actor, word: str) -> bool:
    """Say whether the missions and projects that hold a word are known by their ids."""
    said = actor.looked.of(word)
    return said.mission_ids is not None and said.project_ids is not None


def mission_may_hold(actor: Actor, word: str) -> ColumnElement[bool] | None:
    """Return a condition without which no file of a mission holds a word; None where only the files can tell."""
    said = actor.looked.of(word)
    if _in_file(said):
        return None
    in_topics = [may_have_topic(each) for each in _in_topics(said, mission_topic)]
    return or_(false(), *_in_mission(actor, said), *in_topics)


def in_general(words: Iterable[Said]) -> tuple[Said, ...]:
    """Return what stands for any words of which as much is known: their values are given to a statement by name."""

    def known(held: str | None) -> str | None:
        return held if held is None or held == NONE_AT_ALL else "{...}"

    return tuple(
        Said(
            f"word_{number}",
            project_ids=known(said.project_ids),
            mission_ids=known(said.mission_ids),
            file_ids=known(said.file_ids),
            topics=known(said.topics),
            types=known(said.types),
            is_general=True,
            is_escaped=_is_escaped(said),
        )
        for number, said in enumerate(words)
    )


def values_of(words: Iterable[Said]) -> dict[str, object]:
    """Return the values of words, by the names that statements have for them where they stand `in_general`."""
    values: dict[str, object] = {}
    for number, said in enumerate(words):
        each = {"text": containing(said.word), "key": containing(name_key(said.word)), "projects": said.project_ids}
        each |= {"missions": said.mission_ids, "files": said.file_ids, "topics": said.topics}
        each |= {"types": said.types}
        values |= {f"word_{number}_{what}": value for what, value in each.items()}
    return values


def holds(column: ColumnElement[str], said: Said) -> ColumnElement[bool]:
    """Return the condition that a text contains a word, in any case."""
    return column.ilike(_given(said, "text", containing(said.word), column.type), escape=ESCAPE)


def key_holds(column: ColumnElement[str], said: Said) -> ColumnElement[bool]:
    """Return the condition that a column of name keys contains a word, in any case and Unicode form."""
    return column.like(_given(said, "key", containing(name_key(said.word)), column.type), escape=ESCAPE)


def _given(said: Said, what: str, value: str, kind: TypeEngine[Any]) -> BindParameter[Any]:
    return bindparam(f"{said.word}_{what}", type_=kind) if said.is_general else bindparam(None, value, kind)


def _named(column: ColumnElement[Any], said: Said, what: str, values: str) -> Conditions:
    if values == NONE_AT_ALL:
        return []
    return [column == any_(_given(said, what, values, Written("TEXT" if what in {"topics", "types"} else "UUID")))]


def _is_escaped(said: Said) -> bool:
    return said.is_escaped if said.is_general else _ESCAPED_IN_JSON.search(said.word) is not None


def _in_file(said: Said) -> Conditions:
    return _path_or_label_holds(said) if said.file_ids is None else _named(file.c.id, said, "files", said.file_ids)


def _in_mission(actor: Actor, said: Said) -> Conditions:
    # All of it said of the mission's own columns, so that their indexes can be asked together.
    if said.project_ids is None:
        named = select(project.c.id).where(key_holds(project.c.name_key, said)).correlate(None)
        in_project: Conditions = [mission.c.project_id == any_(func.array(named.scalar_subquery()))]
    else:
        in_project = _named(mission.c.project_id, said, "projects", said.project_ids)
    if said.mission_ids is not None:
        return _named(mission.c.id, said, "missions", said.mission_ids) + in_project
    says = _mission_says(said, whole=sees_whole_missions(actor))
    if actor.looked.goes_through_all:
        # Once of each mission, and not of each of its files.
        says = [mission.c.id.in_(select(mission.c.id).where(or_(*says)).correlate(None))]
    return says + in_project


def _in_topics(said: Said, table: Table = topic) -> Conditions:
    # Of all topics there are few names and types.
    return [
        *_one_of(table.c.name, said, "topics", said.topics, topic_name.c.name),
        *_one_of(table.c.message_type, said, "types", said.types, _MESSAGE_TYPES.c.message_type),
    ]


def _one_of(
    column: ColumnElement[str], said: Said, what: str, values: str | None, every: ColumnElement[str]
) -> Conditions:
    if values is not None:
        return _named(column, said, what, values)
    named = select(every).where(holds(every, said)).correlate(None)
    return [column == any_(func.array(named.scalar_subquery()))]


def _message_types() -> CTE:
    """Return all message types, each once, by one probe of their index for each: `DISTINCT` would read every topic."""
    first = select(func.min(topic.c.message_type).label("message_type"))
    types = first.cte("message_types", recursive=True)
    following = select(func.min(topic.c.message_type)).where(topic.c.message_type > types.c.message_type)
    each = select(following.correlate(types).scalar_subquery()).where(types.c.message_type.is_not(None))
    return types.union_all(each.limit(_MOST_TYPES))


_MESSAGE_TYPES = _message_types()


def _looked_up(in_file: Conditions, in_mission: Conditions, in_topics: Conditions) -> CompoundSelect[Any]:
    """Return the ids of all files of which one of these holds, each asked in an index of its own."""
    by_mission = select(file.c.id).join(mission, mission.c.id == file.c.mission_id)
    by_topic = select(file.c.id).join(topic, topic.c.blob_id == file.c.blob_id)
    found = [select(file.c.id).where(each) for each in in_file]
    found += [by_mission.where(or_(*in_mission))] if in_mission else []
    found += [by_topic.where(each) for each in in_topics]
    return union_all(*(each.correlate(None) for each in found))


def _path_or_label_holds(said: Said) -> Conditions:
    return [of_paths(key_holds(file.c.path_key, said)), _label_holds(said)]


def _label_holds(said: Said) -> ColumnElement[bool]:
    # Most files have no label: to see that is quicker than to join none.
    return and_(func.cardinality(file.c.labels) > 0, holds(func.joined(file.c.labels), said))


def of_paths(condition: ColumnElement[bool]) -> ColumnElement[bool]:
    """Return a condition on the path of a `file` as both indexes of paths have it: with a time, and without one."""
    timed = file.c.start_ns.is_not(None)
    return or_(and_(timed, condition), and_(~timed, condition))


def _mission_says(said: Said, *, whole: bool) -> Conditions:
    named = key_holds(mission.c.name_key, said)
    if not whole:
        return [named]
    values = func.jsonb_path_query(mission.c.metadata, cast("strict $.**", JSONPATH))
    each = values.table_valued("value").render_derived(name="said")
    as_text = each.c.value.op("#>>", return_type=Text())(bindparam(None, [], ARRAY(Text)))
    scalar = func.jsonb_typeof(each.c.value).not_in(["object", "array"])
    in_values: ColumnElement[bool] = select(each.c.value).where(holds(as_text, said), scalar).exists()
    if not _is_escaped(said):
        # The whole as text has an index, and is quickly looked through; but it holds the names of fields too.
        in_values = and_(holds(cast(mission.c.metadata, Text), said), in_values)
    return [named, holds(mission.c.notes, said), in_values]


def blob_has_topic(*conditions: ColumnElement[bool], one_by_one: bool = False) -> ColumnElement[bool]:
    """Say of each `file` whether conditions hold of one of its topics; `one_by_one` where few files are looked at."""
    # Its own look at the topics, even where the statement around it lists topics too.
    its_topics = select(true()).where(topic.c.blob_id == file.c.blob_id, *conditions).correlate(file)
    return is_there(its_topics) if one_by_one else its_topics.exists()


async def look_up(db: Connection, actor: Actor, words: Iterable[str]) -> tuple[Said, ...]:
    """Return where each word is said. Nothing of rights: whatever is found by this asks for those itself."""
    asked = [*dict.fromkeys(words)]
    if not asked:
        return ()
    said = tuple(map(Said, asked))
    whole, general, values = sees_whole_missions(actor), in_general(said), values_of(said)
    bounds = _FILES_DRAWN, _MISSIONS_DRAWN, _MOST
    seen = (await db.execute(_first_look(general, *bounds, whole=whole), values)).one()._mapping
    wanted = [
        (kind, number)
        for number, word in enumerate(asked)
        for kind, drawn in (("files", _FILES_DRAWN), ("missions", _MISSIONS_DRAWN))
        if has_index(word) and not _is_common(seen[kind], seen[f"{kind}_{number}"], drawn)
    ]
    found: Mapping[Any, Any] = {}
    if wanted:
        found = (await db.execute(_second_look(general, tuple(wanted), _MOST, whole=whole), values)).one()._mapping
    return tuple(
        Said(
            word,
            project_ids=_few(seen[f"projects_{number}"]),
            mission_ids=_few(found.get(f"missions_{number}")),
            file_ids=_few(found.get(f"files_{number}")),
            topics=_few(seen[f"topics_{number}"]),
            types=_few(seen[f"types_{number}"]),
        )
        for number, word in enumerate(asked)
    )


async def is_known_untimed(db: Connection, words: Sequence[Said]) -> bool:
    """Say whether the indexes of paths and labels know that no file which holds all of some words has a time.

    So it is where one of them is in nothing but paths and labels, and in none of a file that has one.
    """
    in_files_alone = [
        each for each in words if {each.project_ids, each.mission_ids, each.topics, each.types} == {NONE_AT_ALL}
    ]
    if not in_files_alone:
        return False
    general = in_general(in_files_alone)
    held = (await db.execute(_timed(general), values_of(in_files_alone))).one()
    return NONE_AT_ALL in held


@lru_cache(maxsize=KEPT)
def _timed(words: Sequence[Said]) -> Select[Any]:
    """Return for each word whether a file that has a time holds it: the id of one, in an array."""
    of_time = select(file.c.id).where(file.c.start_ns.is_not(None))
    held = (of_time.where(or_(key_holds(file.c.path_key, word), _label_holds(word))) for word in words)
    return select(*(_first(f"timed_{number}", each, 0) for number, each in enumerate(held)))


@lru_cache(maxsize=KEPT)
def _first_look(words: Sequence[Said], files_drawn: int, missions_drawn: int, most: int, *, whole: bool) -> Select[Any]:
    """Return the projects, topics and types that hold each word, and how many of some files and missions do."""
    files = _drawn("files", file.c.id, [or_(*_path_or_label_holds(word)) for word in words], files_drawn)
    says = [or_(*_mission_says(word, whole=whole)) for word in words]
    missions = _drawn("missions", mission.c.id, says, missions_drawn)
    columns: list[ColumnElement[Any]] = [*files.c, *missions.c]
    for number, word in enumerate(words):
        projects = select(project.c.id).where(key_holds(project.c.name_key, word))
        topics = select(topic_name.c.name).where(holds(topic_name.c.name, word))
        types = select(_MESSAGE_TYPES.c.message_type).where(holds(_MESSAGE_TYPES.c.message_type, word))
        columns += [_first(f"projects_{number}", projects, most), _first(f"topics_{number}", topics, most)]
        columns.append(_first(f"types_{number}", types, most))
    return select(*columns).select_from(files.join(missions, true()))


@lru_cache(maxsize=KEPT)
def _second_look(words: Sequence[Said], wanted: Sequence[tuple[str, int]], most: int, *, whole: bool) -> Select[Any]:
    """Return the files and missions that hold those words that are not common there."""
    columns = []
    for kind, number in wanted:
        word = words[number]
        if kind == "files":
            held = select(file.c.id).where(or_(*_path_or_label_holds(word)))
        else:
            held = select(mission.c.id).where(or_(*_mission_says(word, whole=whole)))
        columns.append(_first(f"{kind}_{number}", held, most))
    return select(*columns)


def _drawn(name: str, key: ColumnElement[Any], conditions: Conditions, most: int) -> Subquery:
    """Return how many rows were drawn by lot, as `name`, and of how many of them each condition holds."""
    holding = [condition.label(f"holds_{number}") for number, condition in enumerate(conditions)]
    drawn = select(*holding).order_by(key).limit(most).subquery()
    hits = [func.count().filter(held).label(f"{name}_{number}") for number, held in enumerate(drawn.c)]
    return select(func.count().label(name), *hits).select_from(drawn).subquery()


def _first(name: str, found: Select[Any], most: int) -> ColumnElement[Any]:
    # The select is planned as if all of it were wanted: with a limit of its own, the database would rather walk the
    # table until enough are met, and walk all of it where there are none.
    every = found.cte(f"every_{name}").prefix_with("MATERIALIZED")
    first = func.array(select(*every.c).limit(most + 1).scalar_subquery(), type_=ARRAY(Text))
    return cast(first, Text).label(name)


def _is_common(drawn: int, hits: int, most: int) -> bool:
    return drawn == most and hits * _COMMON >= most


def _few(written: str | None) -> str | None:
    # A name that holds a comma makes them seem more: what is not named is found as well.
    return None if written is None or (written != NONE_AT_ALL and written.count(",") >= _MOST) else written
