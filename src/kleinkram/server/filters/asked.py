"""What is asked, without its values: words, people and ids differ, and the statement is the same (`access.whoever`)."""

import uuid
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

from sqlalchemy import BindParameter, Uuid, bindparam

from kleinkram.contract.files import FileFilter
from kleinkram.contract.missions import MissionFilter
from kleinkram.contract.query.words import joined
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.looked import Found
from kleinkram.server.access.whoever import asking, whoever
from kleinkram.server.filters.text import in_general, values_of, words_of

_ANY_FOUND = Found(0, "", "", "", "", is_general=True)
Filter = TypeVar("Filter", MissionFilter, FileFilter)


class _AnyId(uuid.UUID):
    """Stands in a filter for whatever id it has there: a statement has a parameter in its place."""

    def __clause_element__(self) -> BindParameter[uuid.UUID]:
        return _GIVEN[self]


_ANY_ID = {name: _AnyId(int=number) for number, name in enumerate(("project_id", "mission_id", "recording_id"))}
_GIVEN = {any_id: bindparam(f"asked_{name}", type_=Uuid()) for name, any_id in _ANY_ID.items()}


@dataclass(frozen=True)
class Asked(Generic[Filter]):
    """A filter and who asks: alike for all whose statements are the same but for their values.

    Two are the same where `actor` and `said` are: `said` is all of the filter that is no value.
    """

    actor: Actor
    said: str
    matching: Filter = field(compare=False)


def asked_alike(actor: Actor, matching: Filter) -> Asked[Filter]:
    """Return what is asked, without its values; it is executed with `values`.

    Raises:
        InvalidQuery: there are too many words.
    """
    looked = actor.looked
    alike: dict[str, object] = {name: _ANY_ID[name] for name in _ids_of(matching)}
    # What is left out may say the same words: these are then taken as they are.
    if not _leaves_out(matching):
        words = words_of(matching.text)
        general = in_general(map(looked.of, dict.fromkeys(words)))
        names = dict(zip(dict.fromkeys(words), (each.word for each in general), strict=True))
        alike |= {"text": joined([names[word] for word in words]) or None}
        looked = replace(looked, words=general, led_by=looked.led_by and names[looked.led_by])
    looked = replace(looked, found=looked.found and _ANY_FOUND)
    matching = matching.model_copy(update=alike)
    return Asked(whoever(replace(actor, looked=looked)), matching.model_dump_json(exclude_defaults=True), matching)


def values(actor: Actor, matching: MissionFilter | FileFilter) -> dict[str, object]:
    """Return the values with which a statement for what is `asked_alike` is executed."""
    looked, given = actor.looked, asking(actor) | {f"asked_{name}": each for name, each in _ids_of(matching).items()}
    words = [] if _leaves_out(matching) else [*dict.fromkeys(words_of(matching.text))]
    if looked.found is not None:
        given |= {f"found_{what}": getattr(looked.found, what) for what in ("file_ids", "mission_ids", "blob_ids")}
    return given | values_of(map(looked.of, words))


def _ids_of(matching: MissionFilter | FileFilter) -> dict[str, uuid.UUID]:
    found = {name: getattr(matching, name, None) for name in _ANY_ID}
    return {name: each for name, each in found.items() if each is not None}


def _leaves_out(matching: MissionFilter | FileFilter) -> bool:
    return isinstance(matching, FileFilter) and bool(matching.without)
