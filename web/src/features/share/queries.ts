// Links to a mission (created, listed, revoked), and public projects.
import { useMutation, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys, useList, type List } from "@/api/queries";
import type { components } from "@/api/schema";
import type { Project } from "@/api/types";

export type ShareCreate = components["schemas"]["ShareCreate"];
const PAGE = 50;
const PUBLIC_PAGE = 100;

/** Links to the mission that the viewer may end, those that have ended too. */
export function useShares(missionId: string) {
  return useList(keys.shares, { mission_id: missionId, ended: true, limit: PAGE }, (query, signal) => call(api.GET("/api/v1/shares", { params: { query }, signal })));
}

export function useShareChanges(missionId: string) {
  const queries = useQueryClient();
  const onSuccess = () => void queries.invalidateQueries({ queryKey: ["shares"] });
  const create = useMutation({
    mutationFn: (body: ShareCreate) => call(api.POST("/api/v1/missions/{mission_id}/shares", { params: { path: { mission_id: missionId } }, body })),
    onSuccess,
    meta: { showsItself: true },
  });
  const revoke = useMutation({
    mutationFn: (id: string): Promise<unknown> => call(api.DELETE("/api/v1/shares/{share_id}", { params: { path: { share_id: id } } })),
    onSuccess,
    meta: { showsItself: true },
  });
  return { create, revoke };
}

export function usePublicProjects(text: () => string): List<Project> {
  const projects = useList(
    (query) => keys.projects({ public: true, ...query }),
    () => ({ limit: PUBLIC_PAGE, text: text() || undefined }),
    (query, signal) => call(api.GET("/api/v1/projects", { params: { query }, signal })),
  );
  return { ...projects, rows: computed(() => projects.rows.value.filter((project) => project.is_public)) };
}
