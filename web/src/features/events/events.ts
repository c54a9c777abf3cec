// Events of missions: what a form changes of them, who may change them, and the commands that cut them.
import type { RouteLocationRaw } from "vue-router";
import type { components } from "@/api/schema";
import type { Right } from "@/api/types";
import { missionArguments, quoted } from "@/components/commands";
import { hasRight } from "@/features/file/queries";

type Schemas = components["schemas"];
export type MissionEvent = Schemas["MissionEventRead"];
export type NewEvent = Schemas["MissionEventCreate"];
export type EventChange = Schemas["MissionEventUpdate"];
export type FindingWithTime = Schemas["FindingRead"] & { readonly finding: { readonly time_ns: number } };
export type NamedMission = Parameters<typeof missionArguments>[0];

const NS_PER_S = 1e9;
const AROUND_S = 5;
const AROUND_NS = AROUND_S * NS_PER_S;
/** The API rounds times to doubles, which differ by up to 128 ns: the message of that time is at or before this. */
const ROUNDING_NS = 256n;

/** Returns the log time at which a viewer shows the message of a time of the API. */
export function viewTimeNs(timeNs: number): bigint {
  return BigInt(timeNs) + ROUNDING_NS;
}

/** Whether a person may change or delete an event: with CREATE their own, else with WRITE or DELETE on the mission. */
export function mayChange(event: MissionEvent, personId: string | undefined, right: Right | undefined): { readonly edit: boolean; readonly remove: boolean } {
  const isOwn = personId !== undefined && event.created_by?.id === personId && hasRight(right, "CREATE");
  return { edit: isOwn || hasRight(right, "WRITE"), remove: isOwn || hasRight(right, "DELETE") };
}

/** Where an event is, or will be: log times in nanoseconds; without an end it is a moment. */
export interface EventTimes {
  readonly startNs: number;
  readonly endNs: number | null;
}

/** What a form shows of an event. Times are texts of seconds, the start of seconds after the start of the mission. */
export interface Draft {
  readonly name: string;
  readonly startSeconds: string;
  readonly durationSeconds: string;
  readonly labels: string;
  readonly colour: string;
  readonly note: string;
}

export function eventTimes({ start_ns: startNs, end_ns: endNs }: MissionEvent): EventTimes {
  return { startNs, endNs };
}

type Described = Pick<MissionEvent, "name" | "labels" | "colour" | "note">;

function secondsText(ns: number): string {
  return String(Number((ns / NS_PER_S).toFixed(6)));
}

export function draftOf({ name, labels, colour, note }: Described, { startNs, endNs }: EventTimes, originNs: number): Draft {
  const durationSeconds = endNs === null || endNs === startNs ? "" : secondsText(endNs - startNs);
  return { name, startSeconds: secondsText(startNs - originNs), durationSeconds, labels: labels.join(", "), colour: colour ?? "", note };
}

/** Returns the times of a draft, those that were not edited unchanged; null where a text is no time. */
export function timesOf(draft: Draft, before: Draft, times: EventTimes, originNs: number): EventTimes | null {
  const start = Number(draft.startSeconds);
  const duration = Number(draft.durationSeconds);
  if (draft.startSeconds.trim() === "" || !Number.isFinite(start) || !Number.isFinite(duration) || duration < 0) return null;
  const isMoved = draft.startSeconds !== before.startSeconds;
  const isResized = draft.durationSeconds !== before.durationSeconds;
  const startNs = isMoved ? Math.round(originNs + start * NS_PER_S) : times.startNs;
  if (startNs < 0) return null;
  if (!isMoved && !isResized) return times;
  if (!isResized) return { startNs, endNs: times.endNs === null ? null : startNs + (times.endNs - times.startNs) };
  return { startNs, endNs: duration === 0 ? null : Math.round(startNs + duration * NS_PER_S) };
}

/** Returns the labels in a text. */
export function labelsOf(text: string): string[] {
  return [...new Set(text.split(",").map((label) => label.trim()).filter((label) => label !== ""))];
}

/** Returns the fields that a draft changes; what was not edited is not sent, so that no time is rounded. */
export function changesOf(draft: Draft, before: Draft, times: EventTimes, old: EventTimes): EventChange {
  const labels = labelsOf(draft.labels);
  return {
    ...(draft.name.trim() !== before.name && { name: draft.name.trim() }),
    ...(times.startNs !== old.startNs && { start_ns: times.startNs }),
    ...(times.endNs !== old.endNs && { end_ns: times.endNs }),
    ...(labels.join("\n") !== labelsOf(before.labels).join("\n") && { labels }),
    ...(draft.colour !== before.colour && { colour: draft.colour === "" ? null : draft.colour }),
    ...(draft.note !== before.note && { note: draft.note }),
  };
}

/** Returns the request that adds the event of a draft. */
export function newEvent(draft: Draft, { startNs, endNs }: EventTimes, more: Pick<NewEvent, "finding_id" | "topic" | "file_id"> = {}): NewEvent {
  const colour = draft.colour === "" ? null : draft.colour;
  return { name: draft.name.trim(), start_ns: startNs, end_ns: endNs, labels: labelsOf(draft.labels), colour, note: draft.note, ...more };
}

/** Returns an event as a glob of its name alone, which is no option. */
function nameArgument(name: string): string {
  return quoted(name.replace(/[*?[]/g, "[$&]"));
}

/** Returns the times of an event with what is around it. `endNs` is exclusive. */
export function rangeAround({ start_ns: start, end_ns: end }: Pick<MissionEvent, "start_ns" | "end_ns">): EventTimes & { readonly endNs: number } {
  return { startNs: Math.max(0, start - AROUND_NS), endNs: (end ?? start) + AROUND_NS };
}

/** Returns the command that cuts one event of a mission, of all its recordings. */
export function cutCommand(event: MissionEvent): string {
  const { startNs, endNs } = rangeAround(event);
  const file = `${event.name.replaceAll(/[^\w.-]+/g, "_").replace(/^[-.]+/, "")}.mcap`;
  return `klein cut ${missionArguments(event.mission)} --start ${startNs} --end ${endNs} -o ${quoted(file === ".mcap" ? "event.mcap" : file)}`;
}

/** Returns the command that cuts each event of a mission, or each of a name, into a folder. */
export function cutAllCommand(mission: NamedMission, name: string | null): string {
  return `klein cut --event ${name === null ? "'*'" : nameArgument(name)} --around ${AROUND_S}s ${missionArguments(mission)} -o events`;
}

/** A file and when it was recorded, in nanoseconds. */
export interface FileTimes {
  readonly id: string;
  readonly path: string;
  readonly start_ns: number | null;
  readonly end_ns: number | null;
}

/** Whether an event is of a file between some times, as far as times tell: which files a recording has is not known here. */
export function mayBeOf(event: MissionEvent, { id, start_ns: first, end_ns: last }: Omit<FileTimes, "path">, startNs: number, endNs: number): boolean {
  if (event.refers_to === "file") return event.file?.id === id;
  if (event.refers_to === "recording" && event.recording === null) return false;
  return first !== null && last !== null && last >= startNs && first <= endNs;
}

/** Returns the page that cuts an event in the browser; null where not exactly one file that it can cut has it. */
export function cutPage(event: MissionEvent, files: readonly FileTimes[]): RouteLocationRaw | null {
  const { startNs, endNs } = rangeAround(event);
  const [file, ...others] = files.filter((one) => mayBeOf(event, one, startNs, endNs));
  if (file === undefined || others.length > 0 || !/\.(mcap|bag)$/i.test(file.path)) return null;
  return { name: "file", params: { fileId: file.id }, query: { slice: `${startNs}-${endNs}` } };
}

/** Returns the names or globs of the terms `event:` of a search. */
export function eventTermsOf(query: string): string[] {
  const terms = query.matchAll(/(?:^|\s)event[:=](?:"((?:[^"\\]|\\.)*)"|(\S+))/gi);
  return [...terms].map(([, inner, bare = ""]) => inner?.replaceAll(/\\(.)/gs, "$1") ?? bare).filter((term) => term !== "");
}
