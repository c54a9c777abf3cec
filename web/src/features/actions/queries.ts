// What the pages of actions ask the server.
import { useMutation, useQuery, useQueryClient } from "@tanstack/vue-query";
import { api, call, ifMatch, noteNewEtag, type EtagCarrier } from "@/api/client";
import { keys, usePages } from "@/api/queries";
import type { Action, ActionVersion } from "@/api/types";
import { globOf } from "@/components/glob";

const MOST_CHOICES = 500;

export interface ActionQuery {
  readonly name: string;
  readonly archived: boolean;
}

export function useActions(filters: () => ActionQuery) {
  const query = () => ({ archived: filters().archived, ...(filters().name !== "" && { name: globOf(filters().name) }) });
  return usePages<Action>(
    () => keys.actions(query()),
    (cursor, signal) => call(api.GET("/api/v1/actions", { params: { query: { ...query(), ...(cursor !== undefined && { cursor }) } }, signal })),
  );
}

/** The actions among which one is chosen. */
export function useActionChoice() {
  const query = { limit: MOST_CHOICES };
  return useQuery({
    queryKey: keys.actions(query),
    queryFn: ({ signal }) => call(api.GET("/api/v1/actions", { params: { query }, signal })),
  });
}

export function useAction(actionId: () => string) {
  return useQuery({
    queryKey: ["actions", "one", actionId],
    queryFn: ({ signal }) => call(api.GET("/api/v1/actions/{action_id}", { params: { path: { action_id: actionId() } }, signal })),
    enabled: () => actionId() !== "",
  });
}

export function useVersions(actionId: string) {
  const path = { action_id: actionId };
  return usePages<ActionVersion>(
    () => [...keys.action(actionId), "versions"],
    (cursor, signal) => call(api.GET("/api/v1/actions/{action_id}/versions", { params: { path, query: cursor === undefined ? {} : { cursor } }, signal })),
  );
}

export function useArchiving(actionId: string) {
  const queries = useQueryClient();
  const path = { action_id: actionId };
  return useMutation({
    mutationFn: ({ etag, ...body }: { readonly archived: boolean } & EtagCarrier) =>
      call(api.PATCH("/api/v1/actions/{action_id}", { params: { path, header: ifMatch(etag) }, body })),
    onSuccess: (action, { etag }) => noteNewEtag(etag, action.etag),
    // Also where it was refused: somebody else may have come first.
    onSettled: () => queries.invalidateQueries({ queryKey: ["actions"] }),
  });
}
