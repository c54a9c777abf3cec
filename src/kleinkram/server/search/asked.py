"""What is asked, without its values: words, people and ids that were found differ, and the statement is the same.

To put a statement together, and to look up how it was compiled, takes longer than PostgreSQL takes for most of them. So
each is put together once for all that ask alike, and executed with the values of this one.
"""

import uuid
from dataclasses import dataclass, field, replace
from typing import Any, cast

from sqlalchemy import Uuid, bindparam

from kleinkram.contract.files import FileFilter
from kleinkram.contract.query.words import joined
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.looked import Found
from kleinkram.server.search.words import in_general, values_of, words_of

# Whoever asks, as far as statements say who that is. Without the value, a statement is not executed at all.
_WHOEVER: Any = bindparam("asking_person_id", type_=Uuid())
_ANY_FOUND = Found(0, "", "", "", "", is_general=True)


@dataclass(frozen=True)
class Asked:
    """A filter of files and who asks: alike for all whose statements are the same but for their values.

    Two are the same where `actor` and `said` are: `said` is all of the filter that is no value.
    """

    actor: Actor
    said: str
    matching: FileFilter = field(compare=False)


def asked_alike(actor: Actor, matching: FileFilter) -> Asked:
    """Return what is asked, without its values; it is executed with `values`.

    Raises:
        InvalidQuery: there are too many words.
    """
    looked = actor.looked
    # What is left out may say the same words: the filter is then taken as it is.
    if not matching.without:
        words = words_of(matching.text)
        general = in_general(map(looked.of, dict.fromkeys(words)))
        names = dict(zip(dict.fromkeys(words), (each.word for each in general), strict=True))
        matching = matching.model_copy(update={"text": joined([names[word] for word in words]) or None})
        looked = replace(looked, words=general, led_by=looked.led_by and names[looked.led_by])
    looked = replace(looked, found=looked.found and _ANY_FOUND)
    # Of the rest of who asks no statement of a search says anything.
    somebody = Actor(
        person_id=actor.person_id and cast(uuid.UUID, _WHOEVER),
        name="",
        token_id=None,
        request_id=None,
        kind=actor.kind,
        is_admin=actor.is_admin,
        scopes=actor.scopes,
        limits=actor.limits,
        most=actor.most,
        few_mission_ids=actor.few_mission_ids,
        sees_many=actor.sees_many,
        looked=looked,
    )
    return Asked(somebody, matching.model_dump_json(exclude_defaults=True), matching)


def values(actor: Actor, matching: FileFilter) -> dict[str, object]:
    """Return the values with which a statement for what is `asked_alike` is executed."""
    looked, given = actor.looked, {"asking_person_id": actor.person_id}
    words = [] if matching.without else [*dict.fromkeys(words_of(matching.text))]
    if looked.found is not None:
        given |= {f"found_{what}": getattr(looked.found, what) for what in ("file_ids", "mission_ids", "blob_ids")}
    return given | values_of(map(looked.of, words))
