// Queries of the audit log, its filters in the URL, and texts of events.
import { useQuery } from "@tanstack/vue-query";
import { computed, type ComputedRef } from "vue";
import { useRoute, type LocationQuery } from "vue-router";
import { api, call } from "@/api/client";
import { keys, useList } from "@/api/queries";
import type { operations } from "@/api/schema";
import { globOf } from "@/components/format";
import { startOfDay } from "@/components/time";
import type { AuditEvent, Json } from "@/api/types";
import { texts } from "@/texts/audit";

export type AuditQuery = NonNullable<operations["export_audit_events"]["parameters"]["query"]>;

export const IDS = ["person_id", "token_id", "share_id", "resource_id", "mission_id"] as const;
export const RESOURCE_TYPES = ["project", "mission", "file", "grant", "group", "person", "share", "token", "session"] as const;
/** The event types that the filter lists. The server accepts any pattern. */
export const OPERATIONS = ["*.create", "*.update", "*.delete", "*.restore", "file.upload", "file.download", "file.preview", "grant.*", "token.*", "share.*", "session.*", "access.denied", "auth.refused"] as const;
const DAY = /^\d{4}-\d{2}-\d{2}$/;
const MAX_PROJECTS = 200;

/** Returns the filters in the URL. */
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
    resource_type: text("resource_type"),
    operation: text("operation"),
    project_id: text("project_id"),
    since: since !== undefined && DAY.test(since) ? startOfDay(since) : undefined,
    until: until !== undefined && DAY.test(until) ? startOfDay(until, 1) : undefined,
    as_admin: text("as_admin") === "yes" ? true : undefined,
    ...Object.fromEntries(IDS.map((id) => [id, text(id)])),
  };
  return Object.fromEntries(Object.entries(filters).filter(([, value]) => value !== undefined));
}

/** Returns the URL of the export of the matching events. */
export function exportAddress(query: AuditQuery): string {
  const pairs = Object.entries(query).map(([name, value]) => [name, String(value)]);
  return `/api/v1/audit/export?${new URLSearchParams(pairs).toString()}`;
}

export function useAuditQuery(): ComputedRef<AuditQuery> {
  const route = useRoute();
  return computed(() => queryOf(route.query));
}

export function useEvents(filters: ComputedRef<AuditQuery>) {
  return useList(keys.audit, filters, (query, signal) => call(api.GET("/api/v1/audit", { params: { query }, signal })));
}

/** The projects to choose from; the URL accepts any. */
export function useProjectChoice() {
  const query = { limit: MAX_PROJECTS };
  return useQuery({
    queryKey: keys.projects(query),
    queryFn: ({ signal }) => call(api.GET("/api/v1/projects", { params: { query }, signal })),
  });
}

export interface Difference {
  readonly field: string;
  /** Null: it was not there. */
  readonly before: string | null;
  readonly after: string | null;
}

type Values = Readonly<Record<string, Json>>;

/** Nested mappings are flattened to paths: `required_metadata.robot`. */
function flattened(values: Values, path = ""): Map<string, string> {
  const flat = new Map<string, string>();
  for (const [key, value] of Object.entries(values)) {
    const at = path + key;
    if (typeof value === "object" && value !== null && !Array.isArray(value) && Object.keys(value).length > 0) {
      for (const [inner, text] of flattened(value as Values, `${at}.`)) flat.set(inner, text);
    } else flat.set(at, valueText(value));
  }
  return flat;
}

function valueText(value: Json): string {
  if (typeof value === "string") return value;
  if (Array.isArray(value) && value.every((item) => typeof item === "string")) return value.join(", ");
  return JSON.stringify(value);
}

/** Returns the changed fields, by name. */
export function differences(before: Values, after: Values): readonly Difference[] {
  const [oldValues, newValues] = [flattened(before), flattened(after)];
  const fields = [...new Set([...oldValues.keys(), ...newValues.keys()])].sort();
  return fields
    .map((field) => ({ field, before: oldValues.get(field) ?? null, after: newValues.get(field) ?? null }))
    .filter((item) => item.before !== item.after);
}

/** Returns the name of the actor. */
export function actorOf(event: AuditEvent): string {
  if (event.actor !== null) return event.actor.name;
  if (event.share !== null) return texts.byLink(event.share.name);
  return event.address === null && event.session_id === null && event.request_id === null ? texts.server : texts.stranger;
}

/** Returns the text of an event, which follows the name of the actor. */
export function eventTextOf(event: AuditEvent): string {
  return textOf(texts.operations, event.operation);
}

/** Returns the text for a name; the name itself if there is none, as with a newer server. */
function textOf(words: Readonly<Record<string, string>>, name: string): string {
  return Object.hasOwn(words, name) ? (words[name] ?? "") : name;
}

/** Returns the name of the target; empty if the target is the actor, as in a sign-in. */
export function objectNameOf(event: AuditEvent): string {
  if (event.operation === "admin.read" && event.resource_type === "server") return textOf(texts.reads, event.resource_name);
  return event.resource_type === "session" && event.resource_name === event.actor?.name ? "" : event.resource_name;
}

/** The page of the target of an event; null if it has none. */
export function placeOf(event: AuditEvent) {
  const id = event.resource_id;
  if (id === null) return null;
  if (event.resource_type === "project") return { name: "project", params: { projectId: id } };
  if (event.resource_type === "mission") return { name: "mission", params: { missionId: id } };
  if (event.resource_type === "file") return { name: "file", params: { fileId: id } };
  if (event.resource_type === "group") return { name: "group", params: { groupId: id } };
  if (event.resource_type === "person") return { name: "person", params: { personId: id } };
  return null;
}
