"""Searches the texts of projects for a name or an address, to report where an erasure leaves it."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sqlalchemy as sa

from kleinkram.contract.names import name_key
from kleinkram.contract.people import Mention, MentionPlace
from kleinkram.server.db import ESCAPE, Connection, containing
from kleinkram.server.tables import access_group, check_acceptance, check_note, file, mission, project, share

# Of each kind of object: an admin who finds so many does not correct them one by one.
MOST = 500
# With a backslash, each of these characters stands for itself in PostgreSQL's regular expressions.
_NOT_WORD, _ESCAPED = re.compile(r"(\W)"), r"\\\1"


@dataclass(frozen=True)
class _Place:
    """Objects with texts: where their names are, and their fields, each with the expression that is searched."""

    resource_type: MentionPlace
    rows: sa.FromClause
    id: sa.ColumnElement[object]
    name: sa.ColumnElement[str]
    fields: Mapping[str, sa.ColumnElement[str]]


_PLACES = (
    _Place(
        MentionPlace.project,
        project,
        project.c.id,
        project.c.name,
        {name: project.c[name] for name in ("name", "description", "licence", "citation")},
    ),
    _Place(
        MentionPlace.mission,
        mission,
        mission.c.id,
        mission.c.name,
        {
            "name": mission.c.name_key,
            "notes": mission.c.notes,
            # As in the index of the words of metadata.
            "metadata": sa.cast(mission.c.metadata, sa.Text),
            "metadata_yaml": mission.c.metadata_yaml,
        },
    ),
    _Place(
        MentionPlace.mission,
        check_note.join(mission, mission.c.id == check_note.c.mission_id),
        mission.c.id,
        mission.c.name,
        {"note on a check": check_note.c.text},
    ),
    _Place(
        MentionPlace.mission,
        check_acceptance.join(mission, mission.c.id == check_acceptance.c.mission_id),
        mission.c.id,
        mission.c.name,
        {"accepted check": check_acceptance.c.because},
    ),
    _Place(
        MentionPlace.file,
        file,
        file.c.id,
        file.c.path,
        {"path": file.c.path_key, "labels": sa.func.joined(file.c.labels)},
    ),
    _Place(
        MentionPlace.group,
        access_group,
        access_group.c.id,
        access_group.c.name,
        {"name": sa.case((access_group.c.kind == "custom", access_group.c.name), else_="")},
    ),
    _Place(MentionPlace.share, share, share.c.id, share.c.name, {"name": share.c.name}),
)


async def find_mentions(db: Connection, terms: Sequence[str]) -> list[Mention]:
    """Return at most `MOST` objects of each kind with a text that contains one of the terms as whole words."""
    mentions: list[Mention] = []
    for place in _PLACES if terms else ():
        matches = {field: sa.or_(*(_contains(text, term) for term in terms)) for field, text in place.fields.items()}
        columns = [sa.func.coalesce(match, False).label(field) for field, match in matches.items()]
        stmt = sa.select(place.id.label("object_id"), place.name.label("object_name"), *columns).distinct()
        stmt = stmt.select_from(place.rows).where(sa.or_(*matches.values())).order_by(place.id).limit(MOST)
        for row in (await db.execute(stmt)).mappings():
            fields = [field for field in matches if row[field]]
            mentions.append(
                Mention(resource_type=place.resource_type, id=row["object_id"], name=row["object_name"], fields=fields)
            )
    return mentions


def _contains(text: sa.ColumnElement[str], term: str) -> sa.ColumnElement[bool]:
    """Whether a text contains a term as whole words, in any case. The first condition is that of the indexes."""
    spellings = sorted({term.lower(), name_key(term)})
    return sa.or_(
        *(
            text.ilike(containing(spelling), escape=ESCAPE)
            & text.regexp_match(rf"(^|\W){re.sub(_NOT_WORD, _ESCAPED, spelling)}(\W|$)", flags="i")
            for spelling in spellings
        )
    )
