// Queries of the home page. Storage totals are a separate request, because they are slow to compute. The keys start like
// those of mission lists, so that changes of missions refetch them.
import { queryOptions, useQuery } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";
import { useMe } from "@/api/session";
import type { RouteLocationRaw } from "vue-router";
import type { Tone } from "@/components/tones";

type Schemas = components["schemas"];
export type Home = Schemas["HomeRead"];
export type RecentMission = Schemas["RecentMission"];
export type UnfinishedUpload = Schemas["UnfinishedUpload"];
export type Attention = Schemas["Attention"];

export const homeQuery = queryOptions({
  queryKey: keys.missions({ home: true }),
  queryFn: ({ signal }) => call(api.GET("/api/v1/home", { signal })),
});

export function useHome() {
  return useQuery(homeQuery);
}

/** The storage use by project. */
export function useHomeStorage() {
  return useQuery({
    queryKey: keys.missions({ home: "storage" }),
    queryFn: ({ signal }) => call(api.GET("/api/v1/home/storage", { signal })),
  });
}

/** Whether a user who is not an admin sees no project; undefined until it is known. */
export function useHasNoAccess(isEnabled: () => boolean) {
  const { isAdmin } = useMe();
  const { data, isError } = useQuery({
    queryKey: keys.projects({ any: true }),
    queryFn: ({ signal }) => call(api.GET("/api/v1/projects", { params: { query: { limit: 1 } }, signal })),
    enabled: () => isEnabled() && !isAdmin.value,
  });
  return computed(() => (isAdmin.value || isError.value ? false : data.value && data.value.items.length === 0));
}

type AttentionKind = Attention["kind"];

export const attentionTones: Readonly<Record<AttentionKind, Tone>> = {
  files_corrupt: "bad",
  files_lost: "bad",
  files_broken: "bad",
  files_unread: "attention",
  files_recovered: "attention",
  runs_cannot_start: "bad",
  runs_failed: "attention",
  metadata_missing: "attention",
  scrub_stopped: "bad",
  verifications_overdue: "attention",
  jobs_failed: "bad",
  disk_low: "bad",
};

/** Returns the page where an item can be resolved: the mission, or the admin page for the server. */
export function placeOf({ kind, mission }: Attention): RouteLocationRaw {
  if (mission === null || mission === undefined) return { name: "admin", query: kind === "scrub_stopped" ? { tab: "scrub" } : {} };
  if (kind === "runs_cannot_start" || kind === "runs_failed") {
    return { name: "mission", params: { missionId: mission.id }, query: { tab: "runs" } };
  }
  const query = kind === "metadata_missing" ? {} : { tab: "problems" };
  return { name: "mission", params: { missionId: mission.id }, query };
}

export interface UnfinishedMission {
  readonly mission: UnfinishedUpload["mission"];
  readonly files: readonly UnfinishedUpload[];
  readonly sizeBytes: number;
  /** Null if the store reported none. */
  readonly sentBytes: number | null;
  readonly expiresAt: string;
}

/** Returns unfinished uploads by mission, in the order of their first. */
export function byMission(uploads: readonly UnfinishedUpload[]): readonly UnfinishedMission[] {
  const groups = new Map<string, UnfinishedUpload[]>();
  for (const upload of uploads) groups.set(upload.mission.id, [...(groups.get(upload.mission.id) ?? []), upload]);
  return [...groups.values()].flatMap((files) => {
    const [first] = files;
    return first === undefined ? [] : [summed(first.mission, files)];
  });
}

function summed(mission: UnfinishedUpload["mission"], files: readonly UnfinishedUpload[]): UnfinishedMission {
  const counts = files.flatMap(({ sent_bytes: sent }) => (sent === null ? [] : [sent]));
  return {
    mission,
    files,
    sizeBytes: files.reduce((sum, file) => sum + file.size_bytes, 0),
    sentBytes: counts.length === 0 ? null : counts.reduce((sum, sent) => sum + sent, 0),
    expiresAt: files.reduce((first, file) => (file.expires_at < first ? file.expires_at : first), files[0]?.expires_at ?? ""),
  };
}
