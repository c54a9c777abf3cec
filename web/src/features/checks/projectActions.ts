// Queries and mutations of the actions that a project names.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call } from "@/api/client";
import { keys } from "@/api/queries";
import type { components } from "@/api/schema";
import { formatDuration } from "@/components/format";
import { projectActionTexts as texts } from "@/texts/checks";

type Schemas = components["schemas"];
export type ProjectAction = Schemas["ProjectActionRead"];

const NS_PER_S = 1_000_000_000;

/** Returns when an action runs, as text. */
export function triggerText({ on, idle_s: idle }: Pick<ProjectAction, "on" | "idle_s">): string {
  return on === "idle" && idle !== null ? texts.runsIdle(formatDuration(idle * NS_PER_S)) : texts.runs[on];
}

export function useProjectActions(projectId: string) {
  return useQuery({
    queryKey: keys.projectActions(projectId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/projects/{project_id}/actions", { params: { path: { project_id: projectId } }, signal })),
  });
}

export function useProjectActionChanges(projectId: string) {
  const queries = useQueryClient();
  const path = { project_id: projectId };
  const common = {
    onSuccess: async () => {
      void queries.invalidateQueries({ queryKey: ["missions"] });
      await queries.invalidateQueries({ queryKey: keys.projectActions(projectId) });
    },
    meta: { showsItself: true },
  };
  const add = useMutation({
    mutationFn: (body: Schemas["ProjectActionAdd"]) => call(api.POST("/api/v1/projects/{project_id}/actions", { params: { path }, body })),
    ...common,
  });
  const remove = useMutation({
    mutationFn: (actionId: string) => call(api.DELETE("/api/v1/projects/{project_id}/actions/{action_id}", { params: { path: { ...path, action_id: actionId } } })),
    ...common,
  });
  return { add, remove };
}
