// Queries and mutations of groups.
import { useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call, ifMatch, noteNewEtag } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { components } from "@/api/schema";
import { globOf } from "@/components/format";

export type MemberSet = components["schemas"]["MemberSet"];

const OFFERED = 8;

export function useGroups(name: () => string) {
  const filters = () => ({ name: globOf(name()) || undefined });
  return useList(keys.groups, filters, (query, signal) => call(api.GET("/api/v1/groups", { params: { query }, signal })));
}

export function useGroup(groupId: string) {
  return useQuery({
    queryKey: keys.group(groupId),
    queryFn: ({ signal }) => call(api.GET("/api/v1/groups/{group_id}", { params: { path: { group_id: groupId } }, signal })),
  });
}

export function useMembers(groupId: string) {
  const path = { group_id: groupId };
  return useList(() => keys.members(groupId), { count: true }, (query, signal) =>
    call(api.GET("/api/v1/groups/{group_id}/members", { params: { path, query }, signal })),
  );
}

/** People who can be added, by name. */
export function useCandidates(typed: () => string) {
  return useQuery({
    queryKey: ["people", "candidates", typed],
    queryFn: ({ signal }) => {
      const query = { limit: OFFERED, active: true, ...(typed() !== "" && { text: typed() }) };
      return call(api.GET("/api/v1/people", { params: { query }, signal }));
    },
  });
}

export function useGroupChanges() {
  const queries = useQueryClient();
  async function done<Result>(response: Promise<Result>): Promise<Result> {
    try {
      return await response;
    } finally {
      // Also after a rejection: another user may have been first.
      for (const key of ["groups", "people", "access", "me"]) void queries.invalidateQueries({ queryKey: [key] });
    }
  }
  const one = (groupId: string) => ({ path: { group_id: groupId } });
  const member = (groupId: string, personId: string) => ({ path: { group_id: groupId, person_id: personId } });

  async function rename(groupId: string, name: string, etag?: string): Promise<void> {
    const params = { ...one(groupId), header: ifMatch(etag) };
    const renamed = await done(call(api.PATCH("/api/v1/groups/{group_id}", { params, body: { name } })));
    noteNewEtag(etag, renamed.etag);
  }

  return {
    create: (name: string) => done(call(api.POST("/api/v1/groups", { body: { name } }))),
    rename,
    remove: (groupId: string) => done(call(api.DELETE("/api/v1/groups/{group_id}", { params: one(groupId) }))),
    setMember: (groupId: string, personId: string, body: MemberSet, etag?: string) => {
      const params = { ...member(groupId, personId), header: ifMatch(etag) };
      return done(call(api.PUT("/api/v1/groups/{group_id}/members/{person_id}", { params, body })));
    },
    removeMember: (groupId: string, personId: string) =>
      done(call(api.DELETE("/api/v1/groups/{group_id}/members/{person_id}", { params: member(groupId, personId) }))),
  };
}
