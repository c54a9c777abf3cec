// Queries and mutations of checks: those of a mission, the rules of a project, the matrix and the trend.
import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call, ifMatch, noteNewEtag, type EtagCarrier } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { components } from "@/api/schema";

type Schemas = components["schemas"];
export type Check = Schemas["MissionCheck"];
export type MissionChecks = Schemas["MissionChecksRead"];
export type Acceptance = Schemas["CheckAcceptanceRead"];
export type Note = Schemas["CheckNoteRead"];
export type Rules = Schemas["ProjectChecksRead"];
export type RulesVersion = Schemas["ChecksVersionRead"];
export type Trend = Schemas["CheckTrend"];
export type TrendStep = Schemas["TrendStep"];

/** A mission in the matrix, with the names of all checks in its page, by how often they fail. */
export type MatrixRow = Schemas["CheckMatrixRow"] & { readonly names: readonly string[] };

const PAGE = 100;
const MAX_PAGE = 500;
const MAX_VERSIONS = 500;
const FAST_POLL_MS = 2_000;

/** The checks of a mission; refetched while they run. `hasHistory`: also acceptances and reports that no longer count. */
export function useMissionChecks(missionId: () => string, hasHistory: () => boolean = () => false, isEnabled: () => boolean = () => true) {
  return useQuery({
    queryKey: computed(() => [...keys.missionChecks(missionId()), hasHistory()]),
    queryFn: ({ signal }) => loadMissionChecks(missionId(), hasHistory(), signal),
    enabled: isEnabled,
    placeholderData: keepPreviousData,
    refetchInterval: (running) => (running.state.data?.verdict === "running" ? FAST_POLL_MS : false),
  });
}

/** Load all pages: there are at most twenty. */
async function loadMissionChecks(missionId: string, hasHistory: boolean, signal: AbortSignal): Promise<MissionChecks> {
  const load = (cursor?: string): Promise<MissionChecks> => {
    const query = { all: hasHistory, limit: MAX_PAGE, ...(cursor && { cursor }) };
    return call(api.GET("/api/v1/missions/{mission_id}/checks", { params: { path: { mission_id: missionId }, query }, signal }));
  };
  const first = await load();
  const checks = [...first.checks];
  for (let next = first.next; next; ) {
    const page = await load(next);
    checks.push(...page.checks);
    next = page.next;
  }
  return { ...first, checks, next: null };
}

/** Mutations of the checks of a mission. */
export function useCheckChanges(missionId: string) {
  const queries = useQueryClient();
  const path = { mission_id: missionId };
  const common = {
    onSuccess: async () => {
      for (const list of [["missions", "list"], ["projects"], ["files", "list"]]) void queries.invalidateQueries({ queryKey: list });
      await queries.invalidateQueries({ queryKey: keys.mission(missionId) });
    },
    meta: { showsItself: true },
  };
  return {
    accept: useMutation({
      mutationFn: (body: Schemas["CheckAcceptanceCreate"]) => call(api.POST("/api/v1/missions/{mission_id}/check-acceptances", { params: { path }, body })),
      ...common,
    }),
    withdraw: useMutation({
      mutationFn: (acceptanceId: string) =>
        call(api.DELETE("/api/v1/missions/{mission_id}/check-acceptances/{acceptance_id}", { params: { path: { ...path, acceptance_id: acceptanceId } } })),
      ...common,
    }),
    note: useMutation({
      mutationFn: (body: Schemas["CheckNoteCreate"]) => call(api.POST("/api/v1/missions/{mission_id}/check-notes", { params: { path }, body })),
      ...common,
    }),
    removeNote: useMutation({
      mutationFn: (noteId: string) => call(api.DELETE("/api/v1/missions/{mission_id}/check-notes/{note_id}", { params: { path: { ...path, note_id: noteId } } })),
      ...common,
    }),
  };
}

/** The `checks.yaml` of a project. */
export function useRules(projectId: string) {
  return useQuery({
    queryKey: keys.projectChecks(projectId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/projects/{project_id}/checks", { params: { path: { project_id: projectId } }, signal })),
  });
}

export function useRulesChange(projectId: string) {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: ({ etag, text }: { readonly text: string } & EtagCarrier) =>
      call(api.PUT("/api/v1/projects/{project_id}/checks", { params: { path: { project_id: projectId }, header: ifMatch(etag) }, body: { text } })),
    onSuccess: (rules, { etag }) => {
      noteNewEtag(etag, rules.etag);
      queries.setQueryData(keys.projectChecks(projectId), rules);
      for (const list of [["missions"], ["projects"]]) void queries.invalidateQueries({ queryKey: list });
    },
    meta: { showsItself: true },
  });
}

/** The versions of a project's `checks.yaml`, latest first. */
export function useRulesVersions(projectId: string) {
  return useList(() => [...keys.projectChecks(projectId), "versions"], { limit: MAX_VERSIONS }, (query, signal) =>
    call(api.GET("/api/v1/projects/{project_id}/checks/versions", { params: { path: { project_id: projectId }, query }, signal })),
  );
}

/** One version of a project's `checks.yaml`; 0 is none. */
export function useRulesVersion(projectId: string, number: () => number) {
  return useQuery({
    queryKey: computed(() => [...keys.projectChecks(projectId), "versions", number()]),
    queryFn: ({ signal }) =>
      call(api.GET("/api/v1/projects/{project_id}/checks/versions/{number}", { params: { path: { project_id: projectId, number: number() } }, signal })),
    enabled: () => number() > 0,
    staleTime: Infinity,
  });
}

/** The missions of a project and their checks. The key starts like that of mission lists, so that changes refetch it. */
export function useMatrix(projectId: string) {
  return useList<MatrixRow, { limit: number; count: boolean }>(
    () => keys.missions({ matrix: projectId }),
    { limit: PAGE, count: true },
    async (query, signal) => {
      const page = await call(api.GET("/api/v1/projects/{project_id}/checks/matrix", { params: { path: { project_id: projectId }, query }, signal }));
      return { ...page, items: page.items.map((item) => ({ ...item, names: page.checks })) };
    },
  );
}

export function useTrend(projectId: string, by: () => TrendStep) {
  return useQuery({
    queryKey: computed(() => keys.missions({ trend: projectId, by: by() })),
    queryFn: ({ signal }) =>
      call(api.GET("/api/v1/projects/{project_id}/checks/trend", { params: { path: { project_id: projectId }, query: { by: by() } }, signal })),
    placeholderData: keepPreviousData,
  });
}
