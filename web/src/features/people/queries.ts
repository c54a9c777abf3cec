// Queries and mutations of people.
import { useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { operations } from "@/api/schema";
import type { Access, Project } from "@/api/types";
import { texts } from "@/texts/people";

/** The tabs of the pages for people, groups and access. */
export const peopleTabs = (["people", "groups", "access"] as const).map((key) => ({ key, label: texts.tabs[key], to: { name: key } }));

export type PeopleQuery = NonNullable<operations["list_people"]["parameters"]["query"]>;

/** Projects in which a person's rights are resolved. */
const MAX_PROJECTS = 200;
const AT_ONCE = 4;
const PAGE = 500;

export function usePeople(query: () => PeopleQuery) {
  const filters = () => ({ ...query(), count: true });
  return useList(keys.people, filters, (page, signal) => call(api.GET("/api/v1/people", { params: { query: page }, signal })));
}

export function usePerson(personId: string) {
  return useQuery({
    queryKey: keys.person(personId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/people/{person_id}", { params: { path: { person_id: personId } }, signal })),
  });
}

export function usePersonChanges(personId: string) {
  const queries = useQueryClient();
  const params = { path: { person_id: personId } };
  const old = () => {
    for (const key of ["people", "groups", "access", "tokens", "me"]) void queries.invalidateQueries({ queryKey: [key] });
  };
  async function done<Result>(response: Promise<Result>): Promise<Result> {
    const answer = await response;
    old();
    return answer;
  }
  return {
    makeAdmin: () => done(call(api.POST("/api/v1/people/{person_id}/admin", { params }))),
    unmakeAdmin: () => done(call(api.DELETE("/api/v1/people/{person_id}/admin", { params }))),
    deactivate: () => done(call(api.POST("/api/v1/people/{person_id}/deactivate", { params }))),
    reactivate: () => done(call(api.POST("/api/v1/people/{person_id}/reactivate", { params }))),
    erase: (confirmation: string) => done(call(api.POST("/api/v1/people/{person_id}/erase", { params, body: { confirmation } }))),
    reset: () => call(api.POST("/api/v1/people/{person_id}/reset", { params })),
  };
}

/** The projects to choose from. */
export function useProjects() {
  const query = { limit: MAX_PROJECTS };
  return useQuery({
    queryKey: keys.projects(query),
    queryFn: ({ signal }) => call(api.GET("/api/v1/projects", { params: { query }, signal })),
  });
}

export function useMissionsOf(projectId: () => string) {
  return useQuery({
    queryKey: ["missions", "list", "of", projectId],
    queryFn: ({ signal }) => call(api.GET("/api/v1/missions", { params: { query: { project_id: projectId(), limit: MAX_PROJECTS } }, signal })),
    enabled: () => projectId() !== "",
  });
}

export interface Reach extends Access {
  readonly project: Project;
}

async function accessOf(project: Project, personId: string, signal: AbortSignal): Promise<readonly Reach[]> {
  const reached: Reach[] = [];
  let cursor: string | null = "";
  while (cursor !== null) {
    const query: { limit: number; cursor?: string } = cursor === "" ? { limit: PAGE } : { limit: PAGE, cursor };
    const page = await call(api.GET("/api/v1/projects/{project_id}/access", { params: { path: { project_id: project.id }, query }, signal }));
    reached.push(...page.items.filter(({ person }) => person?.id === personId).map((access) => ({ ...access, project })));
    cursor = page.next ?? null;
  }
  return reached;
}

/** The rights of a person on the projects that the user sees. */
export function useReach(personId: string) {
  return useQuery({
    queryKey: ["access", "person", personId],
    queryFn: async ({ signal }) => {
      const { items: projects } = await call(api.GET("/api/v1/projects", { params: { query: { limit: MAX_PROJECTS } }, signal }));
      const rows: Reach[] = [];
      for (let at = 0; at < projects.length; at += AT_ONCE) {
        const several = await Promise.all(projects.slice(at, at + AT_ONCE).map((project) => accessOf(project, personId, signal)));
        rows.push(...several.flat());
      }
      return { rows, projects: projects.length };
    },
  });
}
