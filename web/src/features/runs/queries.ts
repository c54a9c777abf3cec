// Queries and mutations of runs.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { batched } from "@/api/batched";
import { api, call } from "@/api/client";
import { Problem } from "@/api/problem";
import { keys, useList } from "@/api/queries";
import type { components, operations } from "@/api/schema";
import type { Artifact, RunState } from "@/api/types";

type Schemas = components["schemas"];
export type RunQuery = NonNullable<operations["list_runs"]["parameters"]["query"]>;
export type Finding = Schemas["FindingRead"];
export type RunCheck = Schemas["CheckRead"];
export type Metric = Schemas["MetricRead"];
export type Input = Schemas["RunInput"];
export type Preview = Schemas["Preview"];
/** What is needed of an artifact to show it. */
export type PreviewArtifact = Pick<Artifact, "id" | "run_id" | "path" | "size_bytes">;
export type Sample = Schemas["UsageSample"];

const PAGE = 500;
const MAX_ADDRESSES = 500;
const ACTIVE: readonly RunState[] = ["queued", "preparing", "running", "collecting"];
/** No event reports resource use, so it is polled. */
const POLL_MS = 5_000;

export function isActive(state: RunState): boolean {
  return ACTIVE.includes(state);
}

export function useRuns(query: () => RunQuery) {
  return useList(keys.runs, query, (page, signal) => call(api.GET("/api/v1/runs", { params: { query: page }, signal })));
}

export function useRun(runId: string) {
  return useQuery({
    queryKey: keys.run(runId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/runs/{run_id}", { params: { path: { run_id: runId } }, signal })),
    refetchInterval: (running) => (running.state.data !== undefined && isActive(running.state.data.state) ? POLL_MS : false),
  });
}

export function useRunChecks(runId: () => string, enabled: () => boolean) {
  return useList(({ run_id: id }) => [...keys.run(id), "checks"], () => ({ run_id: runId() }), (query, signal) =>
    call(api.GET("/api/v1/run-checks", { params: { query }, signal })), enabled,
  );
}

export function useFindings(runId: () => string, enabled: () => boolean) {
  return useList(({ run_id: id }) => [...keys.run(id), "findings"], () => ({ run_id: runId() }), (query, signal) =>
    call(api.GET("/api/v1/findings", { params: { query }, signal })), enabled,
  );
}

export function useMetrics(runId: () => string, enabled: () => boolean) {
  return useList(({ run_id: id }) => [...keys.run(id), "metrics"], () => ({ run_id: runId() }), (query, signal) =>
    call(api.GET("/api/v1/run-metrics", { params: { query }, signal })), enabled,
  );
}

export function useInputs(runId: string) {
  const path = { run_id: runId };
  return useList(() => [...keys.run(runId), "inputs"], { limit: PAGE }, (query, signal) =>
    call(api.GET("/api/v1/runs/{run_id}/inputs", { params: { path, query }, signal })),
  );
}

export function useArtifacts(runId: string) {
  const path = { run_id: runId };
  return useList(() => [...keys.run(runId), "artifacts"], { limit: PAGE }, (query, signal) =>
    call(api.GET("/api/v1/runs/{run_id}/artifacts", { params: { path, query }, signal })),
  );
}

async function addressesOf(runId: string, artifactIds: readonly string[], purpose: "download" | "preview"): Promise<ReadonlyMap<string, string>> {
  const params = { path: { run_id: runId } };
  const body = { artifact_ids: [...artifactIds], purpose };
  const { items } = await call(api.POST("/api/v1/runs/{run_id}/artifacts/download", { params, body }));
  return new Map(items.map(({ artifact, url }) => [artifact.id, url]));
}

/** Returns where to read an artifact, for some minutes. */
export async function addressOf(artifact: Artifact): Promise<string> {
  return (await addressesOf(artifact.run_id, [artifact.id], "download")).get(artifact.id) ?? "";
}

const previewAddresses = new Map<string, (artifactId: string) => Promise<string | undefined>>();

/** Returns where to read an artifact that is shown. Those of one run that appear together need one request. */
export async function previewAddressOf({ id, run_id: runId }: PreviewArtifact): Promise<string> {
  const ofRun = previewAddresses.get(runId) ?? batched((ids) => addressesOf(runId, ids, "preview"), MAX_ADDRESSES);
  previewAddresses.set(runId, ofRun);
  try {
    return (await ofRun(id)) ?? "";
  } catch (thrown) {
    if (!(thrown instanceof Problem) || thrown.isPassing) throw thrown;
    return (await addressesOf(runId, [id], "preview")).get(id) ?? ""; // the store may have lost another one of them
  }
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
