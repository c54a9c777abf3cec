// Making a mission, and what the server's refusal says of each field of the form.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { computed, toValue, type MaybeRefOrGetter } from "vue";
import { api, call } from "@/api/client";
import { keys } from "@/api/keys";
import type { FieldProblem, Problem } from "@/api/problem";
import type { components } from "@/api/schema";
import type { Carried } from "@/components/metadata";

type MissionCreate = components["schemas"]["MissionCreate"];
type MissionTemplate = components["schemas"]["MissionTemplate"];

export function useCreateMission(projectId: string) {
  const queries = useQueryClient();
  return useMutation({
    mutationFn: (body: MissionCreate) => call(api.POST("/api/v1/projects/{project_id}/missions", { params: { path: { project_id: projectId } }, body })),
    onSuccess: (mission) => {
      queries.setQueryData(keys.mission(mission.id), mission);
      for (const noun of ["projects", "missions"]) void queries.invalidateQueries({ queryKey: [noun] });
    },
    meta: { showsItself: true },
  });
}

/** Asks what to begin a project's next mission with, as the last one says; anew each time, for it may have been another. */
export function useTemplate(projectId: MaybeRefOrGetter<string>) {
  return useQuery({
    queryKey: computed(() => keys.template(toValue(projectId))),
    queryFn: ({ signal }) => {
      const path = { project_id: toValue(projectId) };
      return call(api.GET("/api/v1/projects/{project_id}/template", { params: { path }, signal }));
    },
    enabled: computed(() => toValue(projectId) !== ""),
    gcTime: 0,
  });
}

/** Returns what an earlier mission said of the next one. */
export function carriedBy(template: MissionTemplate | undefined): Carried {
  return { from: template?.prefilled_from?.name ?? "", values: template?.carried ?? {} };
}

/** What a refusal says: of the name, of the metadata's fields, and whether it says more than that. */
export interface Refusal {
  readonly name: string;
  readonly metadata: readonly FieldProblem[];
  readonly isElsewhere: boolean;
}

/** Returns what a refusal says of the fields of a form that shows the metadata's `shown` ones. */
export function readRefusal(problem: Problem | null, shown: ReadonlySet<string>): Refusal {
  if (problem === null) return { name: "", metadata: [], isElsewhere: false };
  if (problem.code === "name_taken") return { name: problem.message, metadata: [], isElsewhere: false };
  const ofName = problem.code === "invalid_request" ? problem.fields.find(({ field }) => field === "body.name") : undefined;
  const metadata = problem.code === "metadata_invalid" ? problem.fields : [];
  const beside = metadata.filter(({ field }) => shown.has(field.split(".")[0] ?? "")).length + (ofName === undefined ? 0 : 1);
  return { name: ofName?.message ?? "", metadata, isElsewhere: beside === 0 || beside < problem.fields.length };
}
