"""Search over missions, files and topics, facets, labels, and statistics."""

import uuid
from typing import Annotated

from pydantic import AfterValidator, Field

from kleinkram.contract.base import Page, Request, Response
from kleinkram.contract.files import FileFilter, FileRead
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.names import Label, check_text
from kleinkram.contract.problems import ProblemDocument

MAX_QUERY_CHARACTERS = 8192
MAX_LABELLED = 500
QueryText = Annotated[str, AfterValidator(check_text), Field(max_length=MAX_QUERY_CHARACTERS)]
Labels = Annotated[list[Label], Field(max_length=50)]


class FileQuery(FileFilter):
    """A filter of files and the text of a query; both apply, like a single query."""

    query: QueryText | None = None


class TopicFound(Response):
    """A topic of one name and type, over all matching files. `message_count` is null if unknown."""

    name: str
    message_type: str | None
    file_count: int
    message_count: int | None


class SearchRead(Response):
    """The first missions, files and topics that match a query, and their numbers.

    `query` is the normalized text; `filter` its meaning. Missions match themselves or by their files. The lists
    continue at `/missions` and `/files` with the same `query` and `sort=-start`. `is_exact` is false if very many files
    match: all numbers are then estimates with two digits, and the topics those of sampled files.
    """

    query: str
    filter: FileFilter
    missions: Page[MissionRead]
    files: Page[FileRead]
    topics: Page[TopicFound]
    is_exact: bool = True


class FacetValue(Response):
    """A value of a facet. `query` is the text with this value selected, or deselected if it is selected.

    `file_count` is the number of matching files that have it, whatever else of the same facet is selected.
    """

    value: str
    file_count: int
    is_selected: bool
    query: str


class Facet(Response):
    """The files by `name`: `project`, `format`, `content`, `topic`, `type`, `label`, `month` or `meta.FIELD`.

    Or by `verdict`, that of the mission, or `check`, a check of the mission that fails.

    The most frequent values come first, months the latest first; `value_count` is the number of all values.
    """

    name: str
    values: list[FacetValue]
    value_count: int


class FacetsRead(Response):
    """The facets of a query. If `is_exact` is false, they cover only the first `file_count` files."""

    query: str
    file_count: int
    is_exact: bool
    facets: list[Facet]


class LabelChange(Request):
    """Labels to add to files and to remove; a label in both is added."""

    file_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=MAX_LABELLED)]
    add: Labels = []
    remove: Labels = []


class FileLabelled(Response):
    """The result for one file: its labels now, or why they did not change."""

    file_id: uuid.UUID
    labels: list[str] | None
    problem: ProblemDocument | None


class FilesLabelled(Response):
    """The result for each file, in the requested order."""

    items: list[FileLabelled]


class StatsRow(Response):
    """Totals of one group, without the trash. `duration_ns` is the sum of the spans of the recordings.

    Grouped by topic or message type, a recording counts in each of its groups, and `messages` are those of the group.
    """

    group: str | None
    missions: int
    files: int
    recordings: int
    size_bytes: int
    duration_ns: int
    messages: int


class StatsRead(Response):
    """Statistics by `by`: `project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`."""

    by: str
    rows: list[StatsRow]
    total: StatsRow


MAX_BUCKETS = 200

# The maximum number of buckets; the rest of the values that are neither times nor numbers are one more.
Buckets = Annotated[int, Field(ge=1, le=MAX_BUCKETS)]


class Bucket(Response):
    """Files of one month, of one value of a field, or of numbers from `low` (inclusive) to `high` (exclusive).

    All three are null for files without such a time or value.
    """

    value: str | None
    low: float | None = None
    high: float | None = None
    stats: StatsRow


class Overview(Response):
    """Totals of a project, or of everything visible, by `month` of recording or by a metadata field.

    Months and numbers are in ascending order; other values by recorded time, longest first, as many as requested, and
    `other` is the rest. `unit` is that of a number field. `topics` is the number of distinct topic names; null if the
    caller may see only parts of missions.
    """

    by: str
    unit: str | None
    buckets: list[Bucket]
    other: StatsRow | None
    total: StatsRow
    topics: int | None
