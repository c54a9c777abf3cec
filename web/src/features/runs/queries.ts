// Queries and mutations of runs.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys, usePages } from "@/api/queries";
import type { components, operations } from "@/api/schema";
import type { Artifact, Run, RunState } from "@/api/types";

type Schemas = components["schemas"];
export type RunQuery = NonNullable<operations["list_runs"]["parameters"]["query"]>;
export type Finding = Schemas["FindingRead"];
export type Metric = Schemas["MetricRead"];
export type Preview = Schemas["Preview"];
export type Sample = Schemas["UsageSample"];
export type LogChunkRead = Schemas["LogChunkRead"];

const PAGE = 500;
const ACTIVE: readonly RunState[] = ["queued", "preparing", "running", "collecting"];
/** No event reports resource use, so it is polled. */
const LOOK_MS = 5_000;

export function isActive(state: RunState): boolean {
  return ACTIVE.includes(state);
}

export function useRuns(query: () => RunQuery) {
  return usePages<Run>(
    () => keys.runs(query()),
    (cursor, signal) => call(api.GET("/api/v1/runs", { params: { query: { ...query(), ...(cursor !== undefined && { cursor }) } }, signal })),
  );
}

export function useRun(runId: string) {
  return useQuery({
    queryKey: keys.run(runId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/runs/{run_id}", { params: { path: { run_id: runId } }, signal })),
    refetchInterval: (running) => (running.state.data !== undefined && isActive(running.state.data.state) ? LOOK_MS : false),
  });
}

export function useFindings(runId: () => string) {
  return usePages<Finding>(
    () => [...keys.run(runId()), "findings"],
    (cursor, signal) => call(api.GET("/api/v1/findings", { params: { query: { run_id: runId(), ...(cursor !== undefined && { cursor }) } }, signal })),
  );
}

export function useMetrics(runId: () => string) {
  return usePages<Metric>(
    () => [...keys.run(runId()), "metrics"],
    (cursor, signal) => call(api.GET("/api/v1/run-metrics", { params: { query: { run_id: runId(), ...(cursor !== undefined && { cursor }) } }, signal })),
  );
}

export function useInputs(runId: string) {
  return usePages<Schemas["RunInput"]>(
    () => [...keys.run(runId), "inputs"],
    (cursor, signal) => call(api.GET("/api/v1/runs/{run_id}/inputs", { params: { path: { run_id: runId }, query: { limit: PAGE, ...(cursor !== undefined && { cursor }) } }, signal })),
  );
}

export function useArtifacts(runId: string) {
  return usePages<Artifact>(
    () => [...keys.run(runId), "artifacts"],
    (cursor, signal) => call(api.GET("/api/v1/runs/{run_id}/artifacts", { params: { path: { run_id: runId }, query: { limit: PAGE, ...(cursor !== undefined && { cursor }) } }, signal })),
  );
}

/** Returns where to read an artifact, for some minutes. */
export async function addressOf(artifact: Artifact): Promise<string> {
  const params = { path: { run_id: artifact.run_id } };
  const { items } = await call(api.POST("/api/v1/runs/{run_id}/artifacts/download", { params, body: { artifact_ids: [artifact.id] } }));
  return items[0]?.url ?? "";
}

export function useRunChanges(runId: string) {
  const queries = useQueryClient();
  const path = { run_id: runId };

  function old(): void {
    void queries.invalidateQueries({ queryKey: ["runs"] });
  }

  const cancel = useMutation({
    mutationFn: () => call(api.POST("/api/v1/runs/{run_id}/cancel", { params: { path } })),
    onSuccess: old,
    meta: { showsItself: true },
  });
  const retry = useMutation({
    mutationFn: () => call(api.POST("/api/v1/runs/{run_id}/retry", { params: { path, query: { force: true } } })),
    onSuccess: old,
  });
  return { cancel, retry };
}

/** The mission of a run with its current metadata. */
export function useMissionOfRun(missionId: () => string | undefined) {
  return useQuery({
    queryKey: computed(() => keys.mission(missionId() ?? "")),
    queryFn: ({ signal }) => call(api.GET("/api/v1/missions/{mission_id}", { params: { path: { mission_id: missionId() ?? "" } }, signal })),
    enabled: () => missionId() !== undefined,
  });
}
