"""Statistics: the numbers that a paper quotes, grouped as asked."""

from typing import Annotated

from pydantic import Field

from kleinkram.contract.wire import Response


class StatsRow(Response):
    """One group. `duration_ns` sums the recordings' spans; files in the trash do not count.

    Grouped by topic or message type, a recording counts in each of its groups, and `messages` are that group's own.
    """

    group: str | None
    missions: int
    files: int
    recordings: int
    size_bytes: int
    duration_ns: int
    messages: int


class StatsRead(Response):
    """Statistics by `by` (`project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`), and in all."""

    by: str
    rows: list[StatsRow]
    total: StatsRow


MAX_BUCKETS = 200

# Buckets that are told each by itself; what is left of other values than times and numbers is one more.
Buckets = Annotated[int, Field(ge=1, le=MAX_BUCKETS)]


class Bucket(Response):
    """Files of one month, of one value of a field, or of the numbers from `low` on up to below `high`.

    All three are null for what has no such time or value.
    """

    value: str | None
    low: float | None = None
    high: float | None = None
    stats: StatsRow


class Overview(Response):
    """What a project amounts to, or all that one may see, by `month` of recording or by a metadata field.

    Months and numbers come in their order. Other values come with the longest recorded first, as many as were asked
    for, and `other` is all that are left. `unit` is that of a field of numbers. `topics` are the distinct names of
    topics; null for who is shown less than whole missions.
    """

    by: str
    unit: str | None
    buckets: list[Bucket]
    other: StatsRow | None
    total: StatsRow
    topics: int | None
