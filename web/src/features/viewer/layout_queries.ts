// The saved layouts of a project.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed } from "vue";
import { api, call, ifMatch, type EtagCarrier } from "@/api/client";
import { Problem } from "@/api/problem";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";

type Schemas = components["schemas"];
export type Layout = Schemas["ViewerLayoutRead"];

const MOST = 500;
const INVISIBLE = new Set(["not_found", "not_authenticated"]);

/** Returns the layouts of a project by name; null where the user sees the mission only. */
export function useLayouts(projectId: () => string | undefined) {
  return useQuery({
    queryKey: computed(() => keys.viewerLayouts(projectId() ?? "")),
    queryFn: async ({ signal }): Promise<readonly Layout[] | null> => {
      try {
        const params = { path: { project_id: projectId() ?? "" }, query: { limit: MOST } };
        return (await call(api.GET("/api/v1/projects/{project_id}/viewer-layouts", { params, signal }))).items;
      } catch (thrown) {
        if (thrown instanceof Problem && INVISIBLE.has(thrown.code)) return null;
        throw thrown;
      }
    },
    enabled: () => projectId() !== undefined,
  });
}

export function useLayoutChanges(projectId: string) {
  const queries = useQueryClient();
  const path = { project_id: projectId };
  const options = {
    onSettled: () => queries.invalidateQueries({ queryKey: keys.viewerLayouts(projectId) }),
    meta: { showsItself: true },
  };
  const create = useMutation({
    mutationFn: (body: Schemas["ViewerLayoutCreate"]) => call(api.POST("/api/v1/projects/{project_id}/viewer-layouts", { params: { path }, body })),
    ...options,
  });
  const update = useMutation({
    mutationFn: ({ id, etag, ...body }: Schemas["ViewerLayoutUpdate"] & EtagCarrier & { id: string }) =>
      call(api.PATCH("/api/v1/projects/{project_id}/viewer-layouts/{layout_id}", { params: { path: { ...path, layout_id: id }, header: ifMatch(etag) }, body })),
    ...options,
  });
  const remove = useMutation({
    mutationFn: (id: string) => call(api.DELETE("/api/v1/projects/{project_id}/viewer-layouts/{layout_id}", { params: { path: { ...path, layout_id: id } } })),
    ...options,
  });
  return { create, update, remove };
}
