"""Statements that are built once and executed with the words, the ids and the person of each request.

To build a select of a search and to find how it was compiled takes 2 to 5 ms of processor time, and a search has six.
So requests of the same shape share their statements: the same kind of actor and plan, and the same filters but for
words and ids, which are bound by name.
"""

import uuid
from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any, TypeVar

from sqlalchemy import Uuid, bindparam
from sqlalchemy.sql.elements import BindParameter

from kleinkram.contract.files import FileFilter
from kleinkram.contract.missions import MissionFilter
from kleinkram.server.access.actor import Actor
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan
from kleinkram.server.filters.text import words_of

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


def prepare(
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
        for place, matching in enumerate(filters):
            names = [(at, name) for at, name in enumerate(_IDS, len(_IDS) * place) if ids[at] is not None]
            bound.append(matching.model_copy(update={name: _BoundId(int=at) for at, name in names}))
        while len(_built) >= _MAX_STATEMENTS:
            del _built[next(iter(_built))]
        _built[shape] = build(viewer, *bound, plan=plan, **options)
    values = {f"filter_id_{at}": value for at, value in enumerate(ids) if value is not None}
    return _built[shape], values | plan.values() | {"person_id": actor.person_id}
