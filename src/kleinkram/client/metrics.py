"""Tables of metrics, and the names of the metrics that runs reported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from typing_extensions import TypedDict, Unpack

from kleinkram.client._http import query_of
from kleinkram.client._resources import ApiResource, Ref, checked, html_table
from kleinkram.client.errors import ReadingMissing
from kleinkram.client.runs import with_ids
from kleinkram.contract.actions import Better
from kleinkram.contract.metrics import (
    DEFAULT_DIGITS,
    Aggregate,
    MetricName,
    MetricNameFilter,
    MetricNames,
    MetricTableQuery,
    MetricTableRead,
    TextFormat,
)
from kleinkram.contract.text_tables import DIFFERENCE, NO_GROUP, metric_text_table, write_table

if TYPE_CHECKING:
    import pandas as pd


class MetricTableFields(TypedDict, total=False):
    """The keywords that select the runs of a table; projects and missions are a name, an id or an object, or several.

    `query` finds missions. `where` compares metadata, parameters (`param.NAME=…`) and labels (`label.NAME=…`).
    """

    project: Ref | Sequence[Ref]
    mission: Ref | Sequence[Ref]
    action: str
    version: int
    topic: str
    query: str
    where: str | Sequence[str]


class MetricTable(MetricTableRead):
    """A table of a metric, which can be converted."""

    def to_pandas(self) -> pd.DataFrame:
        """Return the values as a pandas frame with a row and column per label; missing cells are NaN.

        Its `attrs` are `metric`, `unit`, `aggregate` and `better`. With a comparison, it has the column `difference`.
        """
        try:
            import pandas
        except ImportError:
            raise ReadingMissing(what="pandas") from None
        values = [[cell.value for cell in row.cells] for row in self.rows]
        labels = [NO_GROUP if row.label is None else row.label for row in self.rows]
        index = pandas.Index(labels, name=self.row_group.removeprefix("metadata."), dtype=object)
        columns = [column.label for column in self.columns]
        frame = pandas.DataFrame(values, index=index, columns=columns, dtype="float64")
        if self.comparison is not None:
            frame[DIFFERENCE] = pandas.Series(self.comparison.differences, index=index, dtype="float64")
        frame.attrs |= {"metric": self.metric, "unit": self.unit}
        frame.attrs |= {"aggregate": self.aggregate.value, "better": self.better.value}
        return frame

    def to_csv(self) -> str:
        """Return the table as CSV with all digits; missing cells are empty."""
        return write_table(metric_text_table(self), TextFormat.csv)

    def to_markdown(self, digits: int = DEFAULT_DIGITS) -> str:
        """Return the table as Markdown, the best value of each row in bold."""
        return write_table(metric_text_table(self), TextFormat.markdown, digits)

    def to_latex(self, digits: int = DEFAULT_DIGITS) -> str:
        r"""Return the table as LaTeX, the best value of each row in bold; it needs `\usepackage{booktabs}`."""
        return write_table(metric_text_table(self), TextFormat.latex, digits)

    def _repr_html_(self) -> str:
        """Return the table, for notebooks."""
        written = metric_text_table(self)
        return html_table([dict(zip(written.headers, row, strict=True)) for row in written.rows])


class Metrics(ApiResource):
    """`client.metrics`."""

    def names(self, *, project: Ref | Sequence[Ref] | None = None, action: str | None = None) -> Sequence[MetricName]:
        """Return the metrics that runs reported, at most 1000, by name."""
        fields = {name: value for name, value in {"project": project, "action": action}.items() if value is not None}
        matching = checked(MetricNameFilter, "The filter", **with_ids(self._api, fields))
        return self.get_names(matching).items

    def get_names(self, matching: MetricNameFilter) -> MetricNames:
        """Return the metrics of the runs that a filter selects, and whether there are more than 1000."""
        return self._api.get("/metrics", MetricNames, query_of(matching))

    def table(
        self,
        metric: str,
        *,
        rows: str = "mission",
        columns: str | Sequence[str] = ("action", "version"),
        aggregate: Aggregate | str = Aggregate.median,
        better: Better | str | None = None,
        compare: Sequence[str] = (),
        all_rows: bool = False,
        **fields: Unpack[MetricTableFields],
    ) -> MetricTable:
        """Return a table of a metric, from the results that count: of the latest run that is done.

        Args:
            metric: its name.
            rows: `mission`, `project`, or a metadata field.
            columns: `action`, `version`, `param.NAME`, `label.NAME`, `topic`, or several; also `"action,version"`.
            aggregate: how several values of a cell become one.
            better: `lower` or `higher`, where the action does not declare it.
            compare: two columns, by label: the second is compared with the first, row by row.
            all_rows: also rows without any run.
            **fields: those of `MetricTableFields`.

        Raises:
            InvalidQuery: the table is too large, or its values have several units; or `compare` names no column.
        """
        selected = with_ids(self._api, {name: value for name, value in fields.items() if value is not None})
        if isinstance(where := selected.get("where"), str):
            selected["where"] = [where]
        matching = checked(
            MetricTableQuery,
            "The table",
            metric=metric,
            rows=row_group(rows),
            columns=[name.strip() for name in columns.split(",")] if isinstance(columns, str) else [*columns],
            aggregate=aggregate,
            better=better,
            compare=[*compare],
            all_rows=all_rows,
            **selected,
        )
        return self.get_table(matching)

    def get_table(self, matching: MetricTableQuery) -> MetricTable:
        """Return the table of a query."""
        return self._api.get("/metrics/table", MetricTable, query_of(matching))


def row_group(name: str) -> str:
    """Return what the API calls rows: `robot`, `meta.robot` and `metadata.robot` are a metadata field."""
    if name in {"mission", "project"} or name.startswith("metadata."):
        return name
    return f"metadata.{name.removeprefix('meta.')}"
