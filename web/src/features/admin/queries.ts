// What the pages for admins ask the server. It is asked again as long as somebody looks.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { isOn } from "./scrub";
import { api, call } from "@/api/client";
import type { components } from "@/api/schema";

export type Setting = components["schemas"]["SettingRead"];
export type FailedJob = components["schemas"]["FailedJob"];
export type JobAmount = components["schemas"]["JobAmount"];
export type Storage = components["schemas"]["AdminStorage"];

const AGAIN_MS = 10_000;
const SOON_MS = 1_000;

export function useStorage() {
  return useQuery({ queryKey: ["admin", "storage"], queryFn: ({ signal }) => call(api.GET("/api/v1/admin/storage", { signal })), refetchInterval: AGAIN_MS });
}

/** The last scrub; while one goes on, it is asked how far that is. */
export function useScrub() {
  return useQuery({
    queryKey: ["admin", "scrub"],
    queryFn: ({ signal }) => call(api.GET("/api/v1/admin/scrub", { signal })),
    refetchInterval: (asked) => (isOn(asked.state.data?.last ?? null) ? SOON_MS : AGAIN_MS),
  });
}

export function useScrubbing() {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: () => call(api.POST("/api/v1/admin/scrub", { body: { believe: false } })),
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
