// Queries and mutations of the access to projects and missions.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { components } from "@/api/schema";
import type { Access, Grant } from "@/api/types";
import { texts } from "@/texts/access";

export type GrantCreate = components["schemas"]["GrantCreate"];
export type GrantChange = components["schemas"]["GrantUpdate"];

export interface Place {
  readonly kind: "project" | "mission";
  readonly id: string;
}

const MAX = 500;
const PAGE = 100;

/** The grants on the project or mission, for users who can change them. */
export function useGrants(place: Place) {
  return useQuery({
    queryKey: place.kind === "project" ? keys.projectGrants(place.id) : keys.missionGrants(place.id),
    queryFn: async ({ signal }): Promise<readonly Grant[]> => {
      const query = { limit: MAX };
      const page = await (place.kind === "project"
        ? call(api.GET("/api/v1/projects/{project_id}/grants", { params: { path: { project_id: place.id }, query }, signal }))
        : call(api.GET("/api/v1/missions/{mission_id}/grants", { params: { path: { mission_id: place.id }, query }, signal })));
      return page.items;
    },
  });
}

/** The effective rights of people. */
export function useAccess(place: () => Place) {
  return useList(
    ({ kind, id }) => (kind === "project" ? keys.projectAccess(id) : keys.missionAccess(id)),
    place,
    ({ cursor, kind, id }, signal) => {
      const query = { limit: PAGE, cursor };
      return kind === "project"
        ? call(api.GET("/api/v1/projects/{project_id}/access", { params: { path: { project_id: id }, query }, signal }))
        : call(api.GET("/api/v1/missions/{mission_id}/access", { params: { path: { mission_id: id }, query }, signal }));
    },
  );
}

export interface Candidate {
  readonly kind: "person" | "group" | "email";
  readonly id: string;
  readonly name: string;
}

const MAX_OFFERED = 8;

/** People and groups with matching names; an email address, whether or not it has an account. */
export function useCandidates(text: () => string) {
  return useQuery({
    queryKey: ["people", "candidates", text],
    queryFn: async ({ signal }): Promise<readonly Candidate[]> => {
      const typed = text().trim();
      const [people, groups] = await Promise.all([
        call(api.GET("/api/v1/people", { params: { query: { text: typed, active: true, limit: MAX_OFFERED } }, signal })),
        call(api.GET("/api/v1/groups", { params: { query: { name: `*${typed.replaceAll(/[*?]/g, "")}*`, limit: MAX_OFFERED } }, signal })),
      ]);
      return [
        ...people.items.map(({ id, name }) => ({ kind: "person" as const, id, name })),
        ...groups.items.map(({ id, name }) => ({ kind: "group" as const, id, name })),
      ];
    },
    enabled: () => text().trim() !== "",
  });
}

export function useGrantChanges(place: Place) {
  const queries = useQueryClient();
  const inProject = { project_id: place.id };
  const inMission = { mission_id: place.id };
  const onSuccess = () => void queries.invalidateQueries({ queryKey: ["access"] });

  const grant = useMutation({
    mutationFn: (body: GrantCreate) =>
      place.kind === "project"
        ? call(api.POST("/api/v1/projects/{project_id}/grants", { params: { path: inProject }, body }))
        : call(api.POST("/api/v1/missions/{mission_id}/grants", { params: { path: inMission }, body })),
    onSuccess,
    meta: { showsItself: true },
  });
  const change = useMutation({
    mutationFn: ({ id, body }: { readonly id: string; readonly body: GrantChange }) =>
      place.kind === "project"
        ? call(api.PATCH("/api/v1/projects/{project_id}/grants/{grant_id}", { params: { path: { ...inProject, grant_id: id } }, body }))
        : call(api.PATCH("/api/v1/missions/{mission_id}/grants/{grant_id}", { params: { path: { ...inMission, grant_id: id } }, body })),
    onSuccess,
    onError: onSuccess, // the list shows the stored rights again
    meta: { showsItself: true },
  });
  const revoke = useMutation({
    mutationFn: (id: string): Promise<unknown> =>
      place.kind === "project"
        ? call(api.DELETE("/api/v1/projects/{project_id}/grants/{grant_id}", { params: { path: { ...inProject, grant_id: id } } }))
        : call(api.DELETE("/api/v1/missions/{mission_id}/grants/{grant_id}", { params: { path: { ...inMission, grant_id: id } } })),
    onSuccess,
    meta: { showsItself: true },
  });
  return { grant, change, revoke };
}

/** Returns who has a right. */
export function holderOf(access: Access): string {
  if (access.person !== null) return access.person.name;
  if (access.to === null) return access.through === "admin" ? texts.admins : texts.everybody;
  if (access.to.kind === "email") return texts.address(access.to.name);
  return access.to.kind === "group" ? texts.members(access.to.name) : access.to.name;
}

/** Returns where a right comes from. */
export function sourceOf(access: Access): string {
  const through = texts.through[access.through];
  if (access.to === null) return through;
  const how = access.to.kind === "group" && access.person !== null ? texts.byGroup(access.to.name) : "";
  return how === "" ? through : `${through}, ${how}`;
}
