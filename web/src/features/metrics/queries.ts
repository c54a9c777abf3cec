// Queries of tables of metrics.
import { keepPreviousData, useQuery } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { components, operations } from "@/api/schema";

type Schemas = components["schemas"];
export type TableQuery = operations["get_metric_table"]["parameters"]["query"];
export type MetricTable = Schemas["MetricTableRead"];
export type MetricRow = Schemas["MetricRow"];
export type MetricCell = Schemas["MetricCell"];
export type MetricColumn = Schemas["MetricColumn"];
export type Aggregate = Schemas["Aggregate"];
export type Better = Schemas["Better"];
export type TextFormat = Schemas["TextFormat"];

/** The names of the metrics of a project, or of all. */
export function useMetricNames(projectId: () => string) {
  const query = () => ({ project_id: projectId() || undefined });
  return useQuery({
    queryKey: computed(() => keys.metricNames(query())),
    queryFn: ({ signal }) => call(api.GET("/api/v1/metrics", { params: { query: query() }, signal })),
    placeholderData: keepPreviousData,
  });
}

/** Tables are expensive: they are loaded again only while runs of them have not ended. */
const POLL_MS = 30_000;

function isRunning(table: MetricTable): boolean {
  return table.rows.some(({ cells }) => cells.some(({ missing }) => missing === "running"));
}

/** A table of a metric; nothing is loaded while the query is null. */
export function useMetricTable(query: () => TableQuery | null) {
  return useQuery({
    queryKey: computed(() => keys.metricTable(query() ?? {})),
    queryFn: ({ signal }) => tableOf(query() ?? { metric: "" }, signal),
    enabled: () => query() !== null,
    refetchInterval: ({ state }) => (state.data !== undefined && isRunning(state.data) ? POLL_MS : false),
    placeholderData: keepPreviousData,
  });
}

function tableOf(query: TableQuery, signal?: AbortSignal): Promise<MetricTable> {
  return call(api.GET("/api/v1/metrics/table", { params: { query }, ...(signal && { signal }) }));
}

/** Returns a table as the server writes it, with its escapes. */
export async function tableText(query: TableQuery, format: TextFormat): Promise<string> {
  const { text } = await tableOf({ ...query, text: format });
  return text ?? "";
}
