// Links to a mission (created, listed, revoked), and public projects.
import { useMutation, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call } from "@/api/client";
import { keys, usePages, type Rows } from "@/api/queries";
import type { components } from "@/api/schema";
import type { Project, Share } from "@/api/types";

export type ShareCreate = components["schemas"]["ShareCreate"];
const PAGE = 50;
const PUBLIC_PAGE = 100;

/** Links to the mission that the viewer may end, those that have ended too. */
export function useShares(missionId: string) {
  const query = { mission_id: missionId, ended: true, limit: PAGE };
  return usePages<Share>(keys.shares({ mission: missionId }), (cursor, signal) =>
    call(api.GET("/api/v1/shares", { params: { query: { ...query, ...(cursor !== undefined && { cursor }) } }, signal })),
  );
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

export function usePublicProjects(text: () => string): Rows<Project> {
  const pages = usePages<Project>(() => keys.projects({ public: text() }), (cursor, signal) => {
    const query = { limit: PUBLIC_PAGE, ...(text() !== "" && { text: text() }), ...(cursor !== undefined && { cursor }) };
    return call(api.GET("/api/v1/projects", { params: { query }, signal }));
  });
  return { ...pages, rows: computed(() => pages.rows.value.filter((project) => project.is_public)) };
}
