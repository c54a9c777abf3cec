// Queries and mutations of the admin pages. They poll while a page is visible.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call } from "@/api/client";
import type { components } from "@/api/schema";
import type { Tone } from "@/components/tones";
import { texts as all } from "@/texts/admin";

export type Setting = components["schemas"]["SettingRead"];
export type FailedJob = components["schemas"]["FailedJob"];
export type JobAmount = components["schemas"]["JobAmount"];
export type Storage = components["schemas"]["AdminStorage"];

const AGAIN_MS = 10_000;
const SOON_MS = 1_000;

export function useStorage() {
  return useQuery({ queryKey: ["admin", "storage"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/storage", { signal })), refetchInterval: AGAIN_MS });
}

/** The last scrub; polls while it runs. */
export function useScrub() {
  return useQuery({
    queryKey: ["admin", "scrub"],
    queryFn: ({ signal }) => call(api.GET("/api/v1/admin/scrub", { signal })),
    refetchInterval: (running) => (isOn(running.state.data?.last ?? null) ? SOON_MS : AGAIN_MS),
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
  return useQuery({ queryKey: ["admin", "jobs"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/jobs", { signal })), refetchInterval: AGAIN_MS });
}

export function useHealth() {
  return useQuery({ queryKey: ["admin", "health"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/health", { signal })), refetchInterval: AGAIN_MS });
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
export type Standing = "waits" | "on" | "stopped" | "done";

export const standingTones: Readonly<Record<Standing, Tone>> = { waits: "plain", on: "accent", stopped: "bad", done: "good" };

/** Returns whether a scrub waits, goes on, was stopped or is done. */
export function standingOf(scrub: Pick<Scrub, "started_at" | "ended_at" | "aborted_reason">): Standing {
  if (scrub.aborted_reason !== null) return "stopped";
  if (scrub.ended_at !== null) return "done";
  return scrub.started_at === null ? "waits" : "on";
}

/** Returns whether there is a scrub that has not come to its end: another one would be the same. */
export function isOn(scrub: Pick<Scrub, "ended_at"> | null): boolean {
  return scrub !== null && scrub.ended_at === null;
}

const texts = all.settings;

/** Returns what a setting is set to, in words; a secret only whether it is set. */
export function valueOf(setting: Setting): string {
  if (setting.is_secret) return setting.is_set ? texts.secret : texts.noSecret;
  const value: unknown = setting.value;
  if (value === null || value === undefined || value === "") return texts.empty;
  if (typeof value === "string") return value;
  return Array.isArray(value) && value.length === 0 ? texts.empty : JSON.stringify(value);
}

/** Returns the settings whose names hold what was typed, in any spelling of words: `trash days`, `TRASH_DAYS`. */
export function matching(settings: readonly Setting[], typed: string, isOnlySet: boolean): readonly Setting[] {
  const words = typed.toLowerCase().split(/[\s_]+/).filter((word) => word !== "");
  return settings.filter((setting) => (!isOnlySet || setting.is_set) && words.every((word) => setting.name.toLowerCase().includes(word)));
}
