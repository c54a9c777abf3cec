"""The execution plan of a search, the missions it is limited to, and statements built once for each shape of requests.

A plan is what is known of a filter before it runs. It decides how rows are read, never who sees them. What differs
between two searches of the same shape (words, names, ids, the person) is bound by name.

Building a select of a search and computing its cache key takes 2 to 5 ms of processor time, and a search has six.
"""

import re
import uuid
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from sqlalchemy import Select, String, Text, Uuid, bindparam, cast, func, select
from sqlalchemy.sql.elements import BindParameter

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter
from kleinkram.contract.missions import MissionFilter
from kleinkram.contract.names import name_key
from kleinkram.contract.query import phrases
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_missions
from kleinkram.server.db import Connection, containing
from kleinkram.server.tables import mission

# Ids are random: the rows with the lowest ids are a sample, and the last of these tells how many rows there are.
ID_COUNT = 2**128
# The most missions of somebody whose files are looked up mission by mission.
MAX_VISIBLE_MISSIONS = 2_000
# Each word is looked for in every column where one can occur.
MAX_WORDS = 20
# Characters that JSON writes differently.
_ESCAPED_IN_JSON = re.compile(r'["\\\x00-\x1f\x7f]')


def words_of(text: str | None) -> list[str]:
    """Return the words of the `text` of a filter. Raises InvalidQuery if there are more than `MAX_WORDS`."""
    words = phrases(text or "")
    if len(words) > MAX_WORDS:
        reason = f"a search has at most {MAX_WORDS} words; put words that belong together in quotes"
        raise InvalidQuery(expression=words[MAX_WORDS], reason=reason)
    return words


@dataclass(frozen=True)
class SearchWord:
    """A word of a filter, with the projects, topics and message types whose names contain it.

    A list is None where it is unknown or too long. `sampled_paths` is how many of 300 paths contain the word. Words
    with a `number` are bound by name, others by value.
    """

    text: str
    number: int | None = None
    project_ids: Sequence[uuid.UUID] | None = None
    topics: Sequence[str] | None = None
    message_types: Sequence[str] | None = None
    sampled_paths: int = 0

    @property
    def pattern(self) -> str | BindParameter[str]:
        """The LIKE pattern of texts that contain the word."""
        return containing(self.text) if self.number is None else bindparam(self.name_of("pattern"), type_=String())

    @property
    def key_pattern(self) -> str | BindParameter[str]:
        """The LIKE pattern of name keys that contain the word."""
        key = containing(name_key(self.text))
        return key if self.number is None else bindparam(self.name_of("key_pattern"), type_=String())

    @property
    def is_escaped_in_json(self) -> bool:
        """Whether JSON writes the word differently."""
        return _ESCAPED_IN_JSON.search(self.text) is not None

    def name_of(self, value: str) -> str:
        """Return the name of the bind parameter that holds a value of the word."""
        return f"word_{self.number}_{value}"

    def values(self) -> dict[str, object]:
        """Return the values of its bind parameters."""
        values = {name: [*names] for name, names in self._lists() if names}
        patterns = {"pattern": containing(self.text), "key_pattern": containing(name_key(self.text))}
        return {self.name_of(name): value for name, value in (patterns | values).items()}

    def shape(self) -> Hashable:
        """Return what distinguishes statements: which lists are known, and which of those are empty."""
        lists = tuple(None if names is None else bool(names) for _, names in self._lists())
        return self.number, self.is_escaped_in_json, lists

    def _lists(self) -> tuple[tuple[str, Sequence[object] | None], ...]:
        return ("project_ids", self.project_ids), ("topics", self.topics), ("message_types", self.message_types)


@dataclass(frozen=True)
class MatchedFiles:
    """All files that a search finds, where there are at most some thousands, with their missions and blobs.

    Ids stay as PostgreSQL writes arrays (`db.ArrayText`), so that none of them is parsed here. `first_ids` are those of
    the first page, in its order.
    """

    file_count: int
    file_ids: str
    mission_ids: str
    blob_ids: str
    first_ids: Sequence[uuid.UUID]


@dataclass(frozen=True)
class SearchPlan:
    """Execution plan of a filter.

    Attributes:
        words: the words of the filter's text, with where they occur.
        leading_word: the rarest word, by whose indexes files are looked up.
        is_common: so many files match that a list is read in its order until the page is full.
        matched: the files themselves, once they are known.
        mission_ids: all missions that the actor sees, as PostgreSQL writes arrays, where these are few.
        finds_nothing: a word occurs nowhere.
        has_time: only files with a recording time are to be found, or only those without.
    """

    words: Mapping[str, SearchWord] = field(default_factory=dict)
    leading_word: str | None = None
    is_common: bool = False
    finds_nothing: bool = False
    matched: MatchedFiles | None = None
    has_time: bool | None = None
    mission_ids: str | None = None

    @property
    def is_selective(self) -> bool:
        """Whether so few files match that they are looked up and sorted, instead of read in the list's order."""
        return self.leading_word is not None or self.matched is not None or self.mission_ids is not None

    def word(self, text: str) -> SearchWord:
        """Return a word with what is known of it."""
        return self.words.get(text) or SearchWord(text)

    def values(self) -> dict[str, object]:
        """Return the values of the bind parameters of statements of this plan."""
        values = {name: value for word in self.words.values() for name, value in word.values().items()}
        if self.mission_ids is not None:
            values["visible_mission_ids"] = self.mission_ids
        if self.matched is not None:
            for name in ("file_ids", "mission_ids", "blob_ids", "first_ids"):
                values[f"matched_{name}"] = getattr(self.matched, name)
        return values

    def shape(self) -> Hashable:
        """Return what distinguishes the statements of plans, apart from the values that are bound by name."""
        words = tuple(word.shape() for word in self.words.values())
        leading = self.leading_word and self.word(self.leading_word).number
        return words, leading, self.is_common, self.matched is None, self.has_time, self.mission_ids is None


NO_PLAN = SearchPlan()


def rounded(number: int) -> int:
    """Return an estimate in its first two digits: the others are not known."""
    return round(number, -max(len(str(number)) - 2, 0))


# A shape has some eight statements; people use some dozen shapes in a day.
_MAX_STATEMENTS = 256
_IDS = ("project_id", "mission_id", "recording_id")
_PERSON_ID: Any = bindparam("person_id", type_=Uuid())  # Any: stands for the id in an actor

Built = TypeVar("Built")
_built: dict[Hashable, Any] = {}  # Any: what each builder returns


class _BoundId(uuid.UUID):
    """Stands in a filter for an id that is bound by name."""

    def __clause_element__(self) -> BindParameter[uuid.UUID]:
        return bindparam(f"filter_id_{self.int}", type_=Uuid())


def prepare_statement(
    build: Callable[..., Built],
    actor: Actor,
    *filters: MissionFilter | FileFilter,
    plan: SearchPlan = NO_PLAN,
    **options: Hashable,
) -> tuple[Built, dict[str, object]]:
    """Return `build(actor, *filters, plan=plan, **options)`, built once for each shape, and the values to execute with.

    Of the actor, `build` must use nothing but their rights, and of the plan nothing but what is bound by name.

    Raises:
        InvalidQuery: there are too many words, or a `where` cannot be used.
    """
    texts = [words_of(matching.text) for matching in filters]
    numbers = {word: number for number, word in enumerate(dict.fromkeys(word for text in texts for word in text))}
    plan = replace(plan, words={word: replace(plan.word(word), number=number) for word, number in numbers.items()})
    viewer = Actor(
        None if actor.person_id is None else _PERSON_ID,
        "",
        None,
        None,
        actor.kind,
        is_admin=actor.is_admin,
        scopes=actor.scopes,
        limits=actor.limits,
        max_right=actor.max_right,
    )
    ids = [getattr(matching, name, None) for matching in filters for name in _IDS]
    shape = (
        build,
        viewer,
        *(matching.model_dump_json(exclude={"text", *_IDS}, exclude_defaults=True) for matching in filters),
        tuple(tuple(numbers[word] for word in text) for text in texts),
        tuple(value is None for value in ids),
        plan.shape(),
        *options.items(),
    )
    if shape not in _built:
        bound = []
        for index, matching in enumerate(filters):
            names = [(at, name) for at, name in enumerate(_IDS, len(_IDS) * index) if ids[at] is not None]
            bound.append(matching.model_copy(update={name: _BoundId(int=at) for at, name in names}))
        while len(_built) >= _MAX_STATEMENTS:
            del _built[next(iter(_built))]
        _built[shape] = build(viewer, *bound, plan=plan, **options)
    values = {f"filter_id_{at}": value for at, value in enumerate(ids) if value is not None}
    return _built[shape], values | plan.values() | {"person_id": actor.person_id}


async def find_visible_mission_ids(db: Connection, actor: Actor, *, at_most: int | None = None) -> str | None:
    """Return the ids of all missions that an actor sees, as PostgreSQL writes arrays, for `SearchPlan.mission_ids`.

    None for an admin, and where these are more than `MAX_VISIBLE_MISSIONS`, or `at_most` where that is fewer.

    PostgreSQL expects that everybody sees most missions: for somebody who sees few of two million files, it would read
    an index of all files in order for seconds. The ids grant nothing: every statement still checks the rights.
    """
    if actor.is_admin:
        return None
    limit = MAX_VISIBLE_MISSIONS if at_most is None else min(at_most, MAX_VISIBLE_MISSIONS)
    ids, count = (await db.execute(*prepare_statement(visible_ids, actor, limit=limit + 1))).one()
    return None if count > limit else ids or "{}"


def visible_ids(actor: Actor, *, plan: SearchPlan, limit: int) -> Select[tuple[str, int]]:
    """Return the ids of the first visible missions, in no order, as PostgreSQL writes arrays, and their number."""
    ids = visible_missions(actor).with_only_columns(mission.c.id, maintain_column_froms=True).limit(limit).subquery()
    return select(cast(func.array_agg(ids.c.id), Text), func.count()).select_from(ids)
