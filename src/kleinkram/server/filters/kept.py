"""What is kept of missions and can be asked instead of all their files, which may be thousands."""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, case, false, func, or_, select, true

from kleinkram.server.tables import MOST_KEPT_TOPICS, mission, mission_topic, mission_topics


def may_have_topic(*conditions: ColumnElement[bool]) -> ColumnElement[bool]:
    """Say of each `mission` whether a file of it may have a topic of which conditions on `mission_topic` hold.

    Where this does not hold, none of its files has one, whoever asks. Where it holds, they have to be looked at: what
    is kept may be of a state that is over, or not whole.
    """
    its_own = select(true()).where(mission_topic.c.mission_id == mission.c.id).correlate(mission)
    of_now = select(true()).where(
        mission_topics.c.mission_id == mission.c.id, mission_topics.c.revision == mission.c.files_revision
    )
    of_now = of_now.correlate(mission)
    is_full = its_own.offset(MOST_KEPT_TOPICS - 1)
    return or_(is_there(its_own.where(*conditions)), ~is_there(of_now), is_there(is_full))


def where_it_may_be(may_be: Sequence[ColumnElement[bool]], found: ColumnElement[bool]) -> ColumnElement[bool]:
    """Return the condition `found`, which is not looked at where one of those before it does not hold."""
    return case((and_(*may_be), found), else_=false()) if may_be else found


def is_there(found: Select[Any]) -> ColumnElement[bool]:
    """Say whether a select finds a row, looked up for each row around it.

    With EXISTS, the database may well go through all there are, to look at a few.
    """
    return func.coalesce(found.limit(1).scalar_subquery(), false())
