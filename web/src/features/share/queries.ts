// Links to a mission: made, listed and ended.
import { useMutation, useQueryClient } from "@tanstack/vue-query";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import { usePages } from "@/api/pages";
import type { components } from "@/api/schema";
import type { Share } from "@/api/types";

export type ShareCreate = components["schemas"]["ShareCreate"];
const PAGE = 50;

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
