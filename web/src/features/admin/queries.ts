// Queries and mutations of the admin pages. They poll while a page is visible.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call } from "@/api/client";
import { useList } from "@/api/queries";
import type { components } from "@/api/schema";
import type { Tone } from "@/components/tones";
import { texts as all } from "@/texts/admin";

export type Setting = components["schemas"]["SettingRead"];
export type FailedJob = components["schemas"]["FailedJob"];
export type CapacityForecast = components["schemas"]["CapacityForecast"];
export type JobAmount = components["schemas"]["JobAmount"];
export type Runner = components["schemas"]["RunnerRead"];
export type Storage = components["schemas"]["AdminStorage"];

const PAGE = 100;
const POLL_MS = 10_000;
const FAST_POLL_MS = 1_000;
// The status sums up all files.
const SLOW_POLL_MS = 60_000;

export function useStorage() {
  return useQuery({ queryKey: ["admin", "storage"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/storage", { signal })), refetchInterval: POLL_MS });
}

/** The last scrub; polls while it runs. */
export function useScrub() {
  return useQuery({
    queryKey: ["admin", "scrub"],
    queryFn: ({ signal }) => call(api.GET("/api/v1/admin/scrub", { signal })),
    refetchInterval: (running) => (isUnfinished(running.state.data?.last ?? null) ? FAST_POLL_MS : POLL_MS),
  });
}

export function useScrubbing() {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: () => call(api.POST("/api/v1/admin/scrub", { body: { accept_losses: false } })),
    onSuccess: () => queries.invalidateQueries({ queryKey: ["admin", "scrub"] }),
    meta: { showsItself: true },
  });
}

export function useJobs() {
  return useQuery({ queryKey: ["admin", "jobs"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/jobs", { signal })), refetchInterval: POLL_MS });
}

export function useHealth() {
  return useQuery({ queryKey: ["admin", "health"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/health", { signal })), refetchInterval: POLL_MS });
}

/** What needs an admin, what is full, and when it will be. */
export function useStatus() {
  return useQuery({ queryKey: ["admin", "status"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/status", { signal })), refetchInterval: SLOW_POLL_MS });
}

export function useRunners() {
  return useList(() => ["admin", "runners"], () => ({ limit: PAGE }), (query, signal) => call(api.GET("/api/v1/runners", { params: { query }, signal })));
}

export function useSettings() {
  return useQuery({ queryKey: ["admin", "settings"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/settings", { signal })) });
}

export function useRetry() {
  const queries = useQueryClient();
  return async (job: FailedJob) => {
    await call(api.POST("/api/v1/admin/jobs/{job_id}/retry", { params: { path: { job_id: job.id } } }));
    void queries.invalidateQueries({ queryKey: ["admin", "jobs"] });
  };
}

export type Scrub = components["schemas"]["ScrubRead"];
export type ScrubState = "queued" | "running" | "stopped" | "done";

export const scrubTones: Readonly<Record<ScrubState, Tone>> = { queued: "plain", running: "accent", stopped: "bad", done: "good" };

/** Returns the state of a scrub. */
export function scrubStateOf(scrub: Pick<Scrub, "started_at" | "ended_at" | "aborted_reason">): ScrubState {
  if (scrub.aborted_reason !== null) return "stopped";
  if (scrub.ended_at !== null) return "done";
  return scrub.started_at === null ? "queued" : "running";
}

/** Whether a scrub is queued or running. */
export function isUnfinished(scrub: Pick<Scrub, "ended_at"> | null): boolean {
  return scrub !== null && scrub.ended_at === null;
}

const texts = all.settings;

/** Returns the value of a setting as text; for a secret, only whether it is set. */
export function valueOf(setting: Setting): string {
  if (setting.is_secret) return setting.is_set ? texts.secret : texts.noSecret;
  const value: unknown = setting.value;
  if (value === null || value === undefined || value === "") return texts.empty;
  if (typeof value === "string") return value;
  return Array.isArray(value) && value.length === 0 ? texts.empty : JSON.stringify(value);
}

/** Returns the settings whose names contain all words of a text: `trash days`, `TRASH_DAYS`. */
export function matching(settings: readonly Setting[], typed: string, isOnlySet: boolean): readonly Setting[] {
  const words = typed.toLowerCase().split(/[\s_]+/).filter((word) => word !== "");
  return settings.filter((setting) => (!isOnlySet || setting.is_set) && words.every((word) => setting.name.toLowerCase().includes(word)));
}
