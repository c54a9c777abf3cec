"""Statistics: the numbers that a paper quotes, grouped as asked."""

from pydantic import BaseModel, ConfigDict


class StatsRow(BaseModel):
    """One group. `duration_ns` sums the recordings' spans; files in the trash do not count.

    Grouped by topic or message type, a recording counts in each of its groups, and `messages` are that group's own.
    """

    model_config = ConfigDict(frozen=True)

    group: str | None
    missions: int
    files: int
    recordings: int
    size_bytes: int
    duration_ns: int
    messages: int


class StatsRead(BaseModel):
    """Statistics by `by` (`project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`), and in all."""

    model_config = ConfigDict(frozen=True)

    by: str
    rows: list[StatsRow]
    total: StatsRow
