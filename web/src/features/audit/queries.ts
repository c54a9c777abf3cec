// What is asked of the record: the address of the page says it, and so does the export.
import { useQuery } from "@tanstack/vue-query";
import { computed, type ComputedRef } from "vue";
import { useRoute, type LocationQuery } from "vue-router";
import { api, call } from "@/api/client";
import { keys, usePages } from "@/api/queries";
import type { operations } from "@/api/schema";
import { globOf } from "@/components/glob";
import { startOfDay } from "@/components/time";

export type AuditQuery = NonNullable<operations["export_audit_events"]["parameters"]["query"]>;

export const IDS = ["person_id", "token_id", "share_id", "noun_id", "mission_id"] as const;
export const NOUNS = ["project", "mission", "file", "grant", "group", "person", "share", "token", "session"] as const;
/** Which acts of a thing are offered; the server takes any pattern. */
export const ACTS = ["*.create", "*.update", "*.delete", "*.restore", "file.upload", "file.download", "file.look", "grant.*", "token.*", "share.*", "session.*", "access.denied", "auth.refused"] as const;
const DAY = /^\d{4}-\d{2}-\d{2}$/;
const MOST_PROJECTS = 200;

/** Returns what the address of the page asks for. */
export function queryOf(address: LocationQuery): AuditQuery {
  const text = (name: string) => {
    const value = address[name];
    return typeof value === "string" && value !== "" ? value : undefined;
  };
  const person = text("person");
  const since = text("since");
  const until = text("until");
  const filters: Record<string, string | boolean | undefined> = {
    person: person === undefined ? undefined : globOf(person),
    noun: text("noun"),
    operation: text("operation"),
    project_id: text("project_id"),
    since: since !== undefined && DAY.test(since) ? startOfDay(since) : undefined,
    until: until !== undefined && DAY.test(until) ? startOfDay(until, 1) : undefined,
    as_admin: text("as_admin") === "yes" ? true : undefined,
    ...Object.fromEntries(IDS.map((id) => [id, text(id)])),
  };
  return Object.fromEntries(Object.entries(filters).filter(([, value]) => value !== undefined));
}

/** Returns where all that matches is had as a file. */
export function exportAddress(query: AuditQuery): string {
  const pairs = Object.entries(query).map(([name, value]) => [name, String(value)]);
  return `/api/v1/audit/export?${new URLSearchParams(pairs).toString()}`;
}

export function useAuditQuery(): ComputedRef<AuditQuery> {
  const route = useRoute();
  return computed(() => queryOf(route.query));
}

export function useEvents(filters: ComputedRef<AuditQuery>) {
  return usePages(
    () => keys.audit(filters.value),
    (cursor, signal) => call(api.GET("/api/v1/audit", { params: { query: { ...filters.value, ...(cursor !== undefined && { cursor }) } }, signal })),
  );
}

/** The projects that one may choose among; beyond these, the address takes any. */
export function useProjectChoice() {
  const query = { limit: MOST_PROJECTS };
  return useQuery({
    queryKey: keys.projects(query),
    queryFn: ({ signal }) => call(api.GET("/api/v1/projects", { params: { query }, signal })),
  });
}
