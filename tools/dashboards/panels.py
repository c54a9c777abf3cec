"""Panels and dashboards in one style, built by Grafana's Foundation SDK.

Each dashboard has the same three variables, which choose the data sources: it works in any Grafana that has them.
"""

import json
import urllib.parse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from grafana_foundation_sdk.builders import common, dashboard, logs, loki, prometheus, stat, table, tempo, timeseries
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models.common import (
    BigValueColorMode,
    BigValueGraphMode,
    LegendDisplayMode,
    LegendPlacement,
    LogsSortOrder,
    StackingMode,
    TooltipDisplayMode,
)
from grafana_foundation_sdk.models.dashboard import (
    DashboardCursorSync,
    DashboardLinkType,
    DataSourceRef,
    Threshold,
    ThresholdsMode,
)

_TAG = "kleinkram"
_METRICS, _LOGS, _TRACES = (DataSourceRef(kind, f"${{{kind}}}") for kind in ("prometheus", "loki", "tempo"))
# What a link to Explore asks for; Grafana replaces the variables.
_RANGE = {"from": "${__from}", "to": "${__to}"}


@dataclass(frozen=True)
class Query:
    """A PromQL expression, and how each of its series is called (`{{label}}`)."""

    expression: str
    legend: str


@dataclass(frozen=True)
class Row:
    """A row of a dashboard."""

    title: str
    panels: Sequence[Any]  # Any: the SDK's panels share no class but a generic builder


@dataclass(frozen=True)
class Dashboard:
    """A dashboard; `name` is its file and the end of its address."""

    name: str
    title: str
    description: str
    rows: Sequence[Row]


def plot(
    title: str,
    unit: str,
    description: str,
    *queries: Query,
    links: Sequence[dashboard.DashboardLink] = (),
    is_stacked: bool = False,
) -> timeseries.Panel:
    """Return values over time."""
    panel = (
        timeseries.Panel()
        .title(title)
        .description(description)
        .datasource(_METRICS)
        .unit(unit)
        .axis_soft_min(0)
        .line_width(1)
        .fill_opacity(10)
        .height(8)
        .span(8)
        .tooltip(common.VizTooltipOptions().mode(TooltipDisplayMode.MULTI))
        .legend(
            common.VizLegendOptions()
            .display_mode(LegendDisplayMode.LIST)
            .placement(LegendPlacement.BOTTOM)
            .show_legend(True)
        )
    )
    if is_stacked:
        panel.stacking(common.StackingConfig().mode(StackingMode.NORMAL))
    if links:
        panel.data_links([*links])
    for number, query in enumerate(queries):
        panel.with_target(_target(query, number))
    return panel


def number(
    title: str,
    unit: str,
    description: str,
    expression: str,
    *,
    good: str = "green",
    limits: Sequence[tuple[float, str]] = (),
) -> stat.Panel:
    """Return the present value; above each limit it has another colour."""
    steps = [Threshold(None, good), *(Threshold(limit, colour) for limit, colour in limits)]
    return (
        stat.Panel()
        .title(title)
        .description(description)
        .datasource(_METRICS)
        .unit(unit)
        .height(4)
        .span(3)
        .color_mode(BigValueColorMode.BACKGROUND if limits else BigValueColorMode.NONE)
        .graph_mode(BigValueGraphMode.NONE)
        .reduce_options(common.ReduceDataOptions().calcs(["lastNotNull"]))
        .thresholds(dashboard.ThresholdsConfig().mode(ThresholdsMode.ABSOLUTE).steps(steps))
        .with_target(_target(Query(expression, title), 0).instant())
    )


def log_lines(title: str, description: str, expression: str) -> logs.Panel:
    """Return lines of the log, latest first."""
    return (
        logs.Panel()
        .title(title)
        .description(description)
        .datasource(_LOGS)
        .height(8)
        .span(12)
        .show_time(True)
        .enable_log_details(True)
        .sort_order(LogsSortOrder.DESCENDING)
        .with_target(loki.Dataquery().expr(expression).ref_id("A").query_type("range").max_lines(200))
    )


def traces(title: str, description: str, expression: str) -> table.Panel:
    """Return the traces that TraceQL finds."""
    return (
        table.Panel()
        .title(title)
        .description(description)
        .datasource(_TRACES)
        .height(8)
        .span(12)
        .with_target(tempo.TempoQuery().query(expression).ref_id("A").query_type("traceql").limit(20))
    )


def link_to_logs(title: str, expression: str) -> dashboard.DashboardLink:
    """Return a link from a series to the lines that LogQL finds; `${__field.labels.route}` is a label of the series."""
    return _link(title, "loki", {"refId": "A", "expr": expression})


def link_to_traces(title: str, expression: str) -> dashboard.DashboardLink:
    """Return a link from a series to the traces that TraceQL finds."""
    return _link(title, "tempo", {"refId": "A", "query": expression, "queryType": "traceql"})


def _link(title: str, kind: str, query: dict[str, str]) -> dashboard.DashboardLink:
    panes = json.dumps({"k": {"datasource": f"${{{kind}}}", "queries": [query], "range": _RANGE}})
    # Grafana replaces variables only where it can read them.
    quoted = urllib.parse.quote(panes, safe="${}_.")
    url = f"/explore?schemaVersion=1&panes={quoted}"
    return dashboard.DashboardLink(title).type(DashboardLinkType.LINK).url(url).target_blank(True)


def _target(query: Query, number: int) -> prometheus.Dataquery:
    reference = chr(ord("A") + number)
    return prometheus.Dataquery().expr(query.expression).legend_format(query.legend).ref_id(reference)


def to_json(page: Dashboard) -> dict[str, Any]:
    """Return the document that Grafana reads; its panels are numbered in their order."""
    links = dashboard.DashboardLink("Kleinkram").type(DashboardLinkType.DASHBOARDS).tags([_TAG]).keep_time(True)
    builder = (
        dashboard.Dashboard(page.title)
        .uid(f"kleinkram-{page.name}")
        .description(page.description)
        .tags([_TAG])
        .timezone("browser")
        .time("now-6h", "now")
        .refresh("1m")
        .readonly()
        .tooltip(DashboardCursorSync.CROSSHAIR)
        .link(links)
    )
    for kind, label in (("prometheus", "Metrics"), ("loki", "Logs"), ("tempo", "Traces")):
        builder.with_variable(dashboard.DatasourceVariable(kind).type(kind).label(label))
    for row in page.rows:
        builder.with_row(dashboard.Row(row.title))
        for panel in row.panels:
            builder.with_panel(panel)
    document: dict[str, Any] = json.loads(JSONEncoder(sort_keys=True).encode(builder.build()))
    for position, panel in enumerate(document["panels"], 1):
        panel["id"] = position
    return document
