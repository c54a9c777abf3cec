// Queries and mutations of projects, and their statistics.
import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call, ifMatch, noteNewEtag, type EtagCarrier } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { components, operations } from "@/api/schema";
import type { Mission } from "@/api/types";
import { formatCount, formatHours, formatSize } from "@/components/format";
import { texts as all } from "@/texts/project";

type Schemas = components["schemas"];
export type ProjectChange = Schemas["ProjectUpdate"];
export type Overview = Schemas["Overview"];
export type StatsRow = Schemas["StatsRow"];
export type MissionQuery = NonNullable<operations["list_missions"]["parameters"]["query"]>;
export type ProjectSort = Schemas["ProjectSort"];

const PAGE = 100;
const MAX_BUCKETS = 60;
/** Missions that are drawn on one axis. */
export const MAX_ON_AXIS = 1000;

export function useProjects(text: () => string, sort: () => ProjectSort) {
  const filters = () => ({ limit: PAGE, sort: sort(), count: true, text: text() || undefined });
  return useList(keys.projects, filters, (query, signal) => call(api.GET("/api/v1/projects", { params: { query }, signal })));
}

export function useProject(projectId: string) {
  return useQuery({
    queryKey: keys.project(projectId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/projects/{project_id}", { params: { path: { project_id: projectId } }, signal })),
  });
}

export function useMissions(query: () => MissionQuery, isEnabled: () => boolean) {
  const filters = () => ({ limit: PAGE, count: true, ...query() });
  return useList(keys.missions, filters, (page, signal) => call(api.GET("/api/v1/missions", { params: { query: page }, signal })), isEnabled);
}

/** The missions that were recorded first, for the axis. */
export function useMissionsOnAxis(query: () => MissionQuery, isEnabled: () => boolean) {
  return useQuery({
    queryKey: computed(() => [...keys.missions(query()), "axis"]),
    queryFn: async ({ signal }): Promise<readonly Mission[]> => {
      const timed: Mission[] = [];
      for (let cursor: string | null | undefined; cursor !== null && timed.length < MAX_ON_AXIS; ) {
        const pageQuery = { ...query(), sort: "start" as const, limit: 500, ...(cursor && { cursor }) };
        const page = await call(api.GET("/api/v1/missions", { params: { query: pageQuery }, signal }));
        timed.push(...page.items);
        cursor = page.next ?? null;
      }
      return timed;
    },
    enabled: isEnabled,
    placeholderData: keepPreviousData,
  });
}

export function useProjectStats(projectId: string, by: () => string) {
  return useQuery({
    queryKey: computed(() => [...keys.project(projectId), "stats", by()]),
    queryFn: ({ signal }) =>
      call(api.GET("/api/v1/projects/{project_id}/stats", { params: { path: { project_id: projectId }, query: { by: by(), max_buckets: MAX_BUCKETS } }, signal })),
    placeholderData: keepPreviousData,
  });
}

export function useCreateProject() {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: (body: { readonly name: string; readonly description: string }) => call(api.POST("/api/v1/projects", { body })),
    onSuccess: () => void queries.invalidateQueries({ queryKey: ["projects"] }),
    meta: { showsItself: true },
  });
}

/** Mutations. After a deletion, call `old` only after leaving the page: it would refetch the deleted item. */
export function useProjectChanges(projectId: string) {
  const queries = useQueryClient();
  const path = { project_id: projectId };

  function old(): void {
    for (const list of ["projects", "missions", "trash"]) void queries.invalidateQueries({ queryKey: [list] });
  }

  const update = useMutation({
    mutationFn: ({ etag, ...body }: ProjectChange & EtagCarrier) =>
      call(api.PATCH("/api/v1/projects/{project_id}", { params: { path, header: ifMatch(etag) }, body })),
    onSuccess: (project, { etag }) => {
      noteNewEtag(etag, project.etag);
      queries.setQueryData(keys.project(projectId), project);
      old();
    },
    meta: { showsItself: true },
  });
  const remove = useMutation({
    mutationFn: () => call(api.DELETE("/api/v1/projects/{project_id}", { params: { path } })),
    meta: { showsItself: true },
  });
  const restore = useMutation({
    mutationFn: () => call(api.POST("/api/v1/trash/{resource_type}/{resource_id}/restore", { params: { path: { resource_type: "project", resource_id: projectId } } })),
    onSuccess: old,
  });
  return { update, remove, restore, old };
}

const texts = all.stats;
const NS_PER_H = 3.6e12;
export const MEASURES = ["duration_ns", "size_bytes", "files", "missions", "messages"] as const;
export type Measure = (typeof MEASURES)[number];

export interface Bar {
  readonly key: string;
  readonly label: string;
  readonly row: StatsRow;
  /** Of the longest bar, from 0 to 1. */
  readonly share: number;
}

/** Returns a number of a measure as people read it. */
export function shownMeasure(measure: Measure, row: StatsRow): string {
  if (measure === "size_bytes") return formatSize(row.size_bytes);
  if (measure === "duration_ns") return formatHours(row.duration_ns);
  return formatCount(row[measure]);
}

/** Returns the bars of an overview; what has no value comes last. */
export function barsOf(overview: Overview, measure: Measure): readonly Bar[] {
  const named = overview.buckets.map(({ value, low, high, stats }) => {
    const isRange = typeof low === "number" && typeof high === "number";
    const nothing = overview.by === "month" ? texts.noMonth : texts.none;
    const label = isRange ? texts.range(low, high, overview.unit ?? "") : (value ?? nothing);
    return { label, row: stats, isNothing: !isRange && value === null };
  });
  const rows = [
    ...named.filter((item) => !item.isNothing),
    ...(overview.other === null ? [] : [{ label: texts.other, row: overview.other }]),
    ...named.filter((item) => item.isNothing),
  ];
  const most = rows.reduce((high, { row }) => Math.max(high, row[measure]), 0);
  return rows.map(({ label, row }, at) => ({ key: `${at} ${label}`, label, row, share: most === 0 ? 0 : row[measure] / most }));
}

function cell(text: string): string {
  // What a table program would take for a formula is marked as text.
  const plain = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\n\r]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
}

/** Returns an overview as CSV. */
export function csvOf(bars: readonly Bar[], total: StatsRow): string {
  const line = (label: string, row: StatsRow) =>
    [cell(label), row.missions, row.files, row.recordings, row.duration_ns / NS_PER_H, row.size_bytes, row.messages].join(",");
  return [texts.columns.join(","), ...bars.map(({ label, row }) => line(label, row)), line(texts.total, total), ""].join("\n");
}
