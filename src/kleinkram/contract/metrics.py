"""Tables of metrics: rows are missions or groups of them, columns versions, parameters, labels or topics of runs."""

import enum
import uuid
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator
from typing_extensions import Self

from kleinkram.contract.actions import Better, ParameterValue
from kleinkram.contract.base import Response
from kleinkram.contract.missions import LocationFilter, MissionRef
from kleinkram.contract.names import Term, Terms, check_text
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.reports import Code
from kleinkram.contract.search import QueryText

MAX_ROWS = 1000
MAX_COLUMNS = 40
MAX_CELLS = 20_000
# Of a cell, the runs that it names.
MAX_CELL_RUNS = 20
MAX_METRIC_NAMES = 1000
DEFAULT_DIGITS = 4

RowGroup = Annotated[
    str, AfterValidator(check_text), Field(max_length=300, pattern=r"^(mission|project|metadata\.[^.]+(\.[^.]+)*)$")
]
"""What a row is: a mission, a project, or the missions with one value of a metadata field (`metadata.FIELD`)."""

Dimension = Annotated[str, Field(pattern=r"^(action|version|topic|param\.[a-z][a-z0-9_]*|label\.[a-z][a-z0-9_.-]*)$")]
"""What distinguishes columns: the action, its version, a parameter (`param.NAME`), a label of the metric
(`label.NAME`), or its topic."""


class Aggregate(str, enum.Enum):
    """How several values of a cell become one number. `latest` is that of the latest run, `count` their number."""

    median = "median"
    mean = "mean"
    min = "min"
    max = "max"
    latest = "latest"
    count = "count"  # type: ignore[assignment]  # hides a method of str, which nobody calls


class TextFormat(str, enum.Enum):
    """A format in which a table can be written."""

    csv = "csv"
    markdown = "markdown"
    latex = "latex"


class MetricNameFilter(LocationFilter):
    """A filter for the metrics of runs. `action` may be a glob."""

    action_id: uuid.UUID | None = None
    action: Term | None = None
    version: Annotated[int, Field(ge=1, lt=2**31)] | None = None


class MetricTableQuery(MetricNameFilter):
    """A table of one metric. Only results that count are in it.

    These are the metrics of the latest run that is done, of each mission and action with the same parameters; where
    `version` is a column, of each version. `query` finds missions by themselves or by their files. `where` compares
    metadata (`robot=anymal`), parameters (`param.method=kiss-icp`) and labels (`label.alignment=se3`); all must hold.
    `topic` may be a glob. `better` overrides what the action declares. `compare` names two columns by their labels, or
    by parts of them. `all_rows`: also rows without any run. With `text`, the response has the table in that format,
    with so many significant `digits`.
    """

    metric: Code
    rows: RowGroup = "mission"
    columns: Annotated[list[Dimension], Field(min_length=1, max_length=10)] = ["action", "version"]
    aggregate: Aggregate = Aggregate.median
    better: Better | None = None
    compare: Annotated[list[Term], Field(max_length=2)] = []
    query: QueryText | None = None
    where: Terms = []
    topic: Term | None = None
    all_rows: bool = False
    text: TextFormat | None = None
    digits: Annotated[int, Field(ge=1, le=17)] = DEFAULT_DIGITS

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if len(set(self.columns)) < len(self.columns):
            raise ValueError("a column is given twice")
        if len(self.compare) == 1:
            raise ValueError("'compare' takes two columns")
        return self


class Missing(str, enum.Enum):
    """Why a cell has no value: the runs that would fill it."""

    no_run = "no_run"
    running = "running"
    failed = "failed"
    cancelled = "cancelled"
    no_metric = "no_metric"


class Rank(str, enum.Enum):
    """The place of a value in its row. Equal values share it."""

    best = "best"
    worst = "worst"


class MetricCell(Response):
    """A cell. `count` is the number of values, `run_count` that of their runs, of which `run_ids` are at most 20.

    Where there is no value, `missing` says why, and `run_ids` names a run behind that, if there is one.
    """

    value: float | None = None
    missing: Missing | None = None
    count: int = 0
    run_count: int = 0
    run_ids: Annotated[list[uuid.UUID], Field(max_length=MAX_CELL_RUNS)] = []
    rank: Rank | None = None


class MetricColumn(Response):
    """A column. `values` are by dimension; null where a result has none, such as no topic."""

    label: str
    values: dict[str, ParameterValue | None]
    action_id: uuid.UUID | None = None


class MetricRow(Response):
    """A row. `label` is null for missions without the metadata field. `mission` and `project` are what it is about."""

    label: str | None
    mission: MissionRef | None = None
    project: ProjectRef | None = None
    cells: list[MetricCell]


class MetricDimension(Response):
    """What could distinguish columns: a name such as `param.method`, and its number of values in these results."""

    name: str
    value_count: int


class MetricComparison(Response):
    """The second column compared with the first, row by row.

    `differences` (second minus first) are by row, null where one of both has no value. Wins are rows in which the
    second is better; they are null where neither direction is.
    """

    first: int
    second: int
    differences: list[float | None]
    pair_count: int
    median_difference: float | None
    mean_difference: float | None
    wins: int | None
    losses: int | None
    ties: int


class MetricTableRead(Response):
    """A table of a metric. Columns are in the order of their values, rows of their labels.

    `varying` names what differs between results of one column and is no column itself. `dimensions` are those of which
    the results have several values.
    """

    metric: str
    unit: str | None
    better: Better
    description: str
    aggregate: Aggregate
    row_group: str
    column_dimensions: list[str]
    columns: list[MetricColumn]
    rows: list[MetricRow]
    dimensions: list[MetricDimension]
    varying: list[str]
    comparison: MetricComparison | None = None
    text: str | None = None


class MetricName(Response):
    """A metric that runs reported, as their actions declare it."""

    name: str
    unit: str | None
    better: Better
    description: str
    run_count: int


class MetricNames(Response):
    """The metrics that runs reported, by name; `truncated` where there are more than 1000."""

    items: list[MetricName]
    truncated: bool
