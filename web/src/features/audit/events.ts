// What an event says, in words and as differences.
import type { AuditEvent, Json } from "@/api/types";
import { texts } from "@/texts/audit";

export interface Difference {
  readonly field: string;
  /** Null: it was not there. */
  readonly before: string | null;
  readonly after: string | null;
}

type Values = Readonly<Record<string, Json>>;

/** Mappings within mappings are told by their path: `required_metadata.robot`. */
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

/** Returns what is not the same before and after, field by field, in the order of their names. */
export function differences(before: Values, after: Values): readonly Difference[] {
  const was = flattened(before);
  const is = flattened(after);
  const fields = [...new Set([...was.keys(), ...is.keys()])].sort();
  return fields
    .map((field) => ({ field, before: was.get(field) ?? null, after: is.get(field) ?? null }))
    .filter((item) => item.before !== item.after);
}

/** Returns who did it. */
export function doerOf(event: AuditEvent): string {
  if (event.actor !== null) return event.actor.name;
  if (event.share !== null) return texts.byLink(event.share.name);
  return event.address === null && event.session_id === null && event.request_id === null ? texts.server : texts.stranger;
}

/** Returns what was done, as it follows who did it. */
export function deedOf(event: AuditEvent): string {
  return worded(texts.operations, event.operation);
}

/** Returns the words for a name; the name itself where there are none, as of a newer server. */
function worded(words: Readonly<Record<string, string>>, name: string): string {
  return Object.hasOwn(words, name) ? (words[name] ?? "") : name;
}

/** Returns the name of what it was done to; nothing where that is whoever did it, as who signs in. */
export function objectOf(event: AuditEvent): string {
  if (event.operation === "admin.look" && event.noun === "server") return worded(texts.reads, event.noun_name);
  return event.noun === "session" && event.noun_name === event.actor?.name ? "" : event.noun_name;
}

/** Where the thing of an event is shown; null where nothing shows it. */
export function placeOf(event: AuditEvent) {
  const id = event.noun_id;
  if (id === null) return null;
  if (event.noun === "project") return { name: "project", params: { projectId: id } };
  if (event.noun === "mission") return { name: "mission", params: { missionId: id } };
  if (event.noun === "file") return { name: "file", params: { fileId: id } };
  if (event.noun === "group") return { name: "group", params: { groupId: id } };
  if (event.noun === "person") return { name: "person", params: { personId: id } };
  return null;
}
