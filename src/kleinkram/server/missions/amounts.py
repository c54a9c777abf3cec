"""What is in a mission: kept with its recordings when these are derived, and added up from its files while they change.

What is kept holds as long as the mission's files are those that it was derived from: a trigger takes the number of
files away when these change. So numbers are always those of this moment, a list of a thousand missions reads no file,
and the files of a hundred thousand are counted in an index. Functions touch no connection.
"""

import uuid
from functools import cache
from typing import Any

from sqlalchemy import (
    ARRAY,
    BigInteger,
    ColumnElement,
    Select,
    Update,
    and_,
    case,
    func,
    select,
    true,
    type_coerce,
    update,
)
from sqlalchemy.dialects.postgresql import array

from kleinkram.contract.files import BlobState, ContentState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions, shown_files, shown_recordings
from kleinkram.server.tables import blob, file, mission, recording

# What costs too much to be summarised is read by the verification; bytes that are damaged wait for nothing.
_UNREAD = blob.c.summarised_at.is_(None) | (blob.c.content == ContentState.pending.value)
_PENDING = blob.c.summarised_at.is_(None) | (
    (blob.c.content == ContentState.pending.value) & (blob.c.state == BlobState.stored.value)
)

# What a mission without files amounts to.
NOTHING = {"file_count": 0, "size_bytes": 0, "message_count": 0, "unread_count": 0, "duration_ns": 0}
# The other numbers are as old as that one.
_IS_KNOWN = mission.c.file_count.is_not(None)


def amounts(actor: Actor) -> ColumnElement[Any]:
    """Return number, bytes and messages of each `mission`'s files, and how many wait to be read, as one array."""
    return _stored_or_added_amounts() if sees_whole_missions(actor) else _added_amounts(shown_files(actor))


def _added_amounts(shown: ColumnElement[bool]) -> ColumnElement[Any]:
    numbers = (func.count(), func.sum(blob.c.size_bytes), func.sum(blob.c.message_count), func.count().filter(_PENDING))
    return _live(shown, _whole_numbers(*numbers))


@cache  # the same for whoever sees all that is in the missions they see
def _stored_or_added_amounts() -> ColumnElement[Any]:
    stored = _whole_numbers(mission.c.file_count, mission.c.size_bytes, mission.c.message_count, mission.c.unread_count)
    # Whether a file still waits may end without its mission being derived anew; where none does, none begins to.
    return case((and_(_IS_KNOWN, mission.c.unread_count == 0), stored), else_=_added_amounts(true()))


def file_amounts(actor: Actor) -> tuple[ColumnElement[Any], ColumnElement[Any]]:
    """Return number and bytes of each `mission`'s files, to be added up over missions."""
    shown = shown_files(actor)
    count, size_bytes = _live(shown, func.count()), _live(shown, func.coalesce(func.sum(blob.c.size_bytes), 0))
    if not sees_whole_missions(actor):
        return count, size_bytes
    return (
        case((_IS_KNOWN, mission.c.file_count), else_=count),
        case((_IS_KNOWN, mission.c.size_bytes), else_=size_bytes),
    )


def duration(actor: Actor) -> ColumnElement[Any]:
    """Return the nanoseconds of each `mission`'s recordings, to be added up over missions; null for none."""
    lasted = select(func.sum(recording.c.end_ns - recording.c.start_ns)).where(recording.c.mission_id == mission.c.id)
    added = lasted.where(shown_recordings(actor)).correlate(mission).scalar_subquery()
    if not sees_whole_missions(actor):
        return added
    # Recordings change when they are derived, which keeps this too, and at no other time.
    return case((mission.c.duration_ns.is_not(None), mission.c.duration_ns), else_=added)


def keep(mission_id: uuid.UUID, **values: object) -> Update:
    """Return the statement that keeps what a mission amounts to, with what else was derived of it."""
    numbers = (func.count(), func.coalesce(func.sum(blob.c.size_bytes), 0))
    read = (func.coalesce(func.sum(blob.c.message_count), 0), func.count().filter(_UNREAD))
    inside = select(_numbers(*numbers, *read)).join_from(file, blob, blob.c.id == file.c.blob_id)
    inside = inside.where(file.c.mission_id == mission_id, file.c.deleted_at.is_(None))
    added = inside.cte("found")
    lasted = select(func.coalesce(func.sum(recording.c.end_ns - recording.c.start_ns), 0))
    derived = {name: select(added.c.numbers[place]).scalar_subquery() for place, name in enumerate(_STORED, start=1)}
    derived["duration_ns"] = lasted.where(recording.c.mission_id == mission_id).scalar_subquery()
    return update(mission).where(mission.c.id == mission_id).values(**values, **derived)


_STORED = ("file_count", "size_bytes", "message_count", "unread_count")


def _live(shown: ColumnElement[bool], what: ColumnElement[Any]) -> ColumnElement[Any]:
    inside = (file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None), shown)
    stmt: Select[Any] = select(what).join_from(file, blob, blob.c.id == file.c.blob_id).where(*inside)
    return stmt.correlate(mission).scalar_subquery()


def _whole_numbers(*numbers: ColumnElement[Any]) -> ColumnElement[Any]:
    # One look at a mission's files for all numbers.
    return type_coerce(array([func.coalesce(number, 0) for number in numbers]), ARRAY(BigInteger))


def _numbers(*numbers: ColumnElement[Any]) -> ColumnElement[Any]:
    return _whole_numbers(*numbers).label("numbers")
