// The values of discrete fields over time: runs of equal values, and the bars that show them.
import type { FilePart } from "./curves";
import type { Span } from "@/recordings/formats/recording";
import type { FieldTypes } from "@/recordings/products/field_types";
import type { ReadMessage } from "@/recordings/products/products";
import type { State, States } from "@/recordings/products/states";

/** A time in which messages had the same value. */
export interface StateRun {
  readonly value: State;
  readonly fromNs: bigint;
  /** The last message with the value. */
  readonly toNs: bigint;
  /** Whether shorter runs with other values are in it, which were too many. */
  readonly isMixed: boolean;
}

export interface StateRuns {
  readonly messages: number;
  readonly byField: ReadonlyMap<string, readonly StateRun[]>;
}

export const EMPTY_RUNS: StateRuns = { messages: 0, byField: new Map() };
/** Runs of a field, and fields. */
export const MAX_RUNS = 4_000;
export const MAX_STATE_FIELDS = 200;
/** Fields in one timeline. */
export const MAX_ROWS = 12;

/** Returns the runs with further messages, which are later. */
export function withStates(runs: StateRuns, messages: readonly ReadMessage<"states">[]): StateRuns {
  const byField = new Map([...runs.byField].map(([field, own]) => [field, [...own]]));
  for (const { logTimeNs, product } of messages) {
    for (const [field, value] of Object.entries(product ?? {})) {
      const own = byField.get(field) ?? [];
      if (own.length === 0 && byField.size >= MAX_STATE_FIELDS) continue;
      byField.set(field, own);
      extend(own, logTimeNs, value);
    }
  }
  return { messages: runs.messages + messages.length, byField };
}

function extend(runs: StateRun[], timeNs: bigint, value: State): void {
  const last = runs.at(-1);
  if (last !== undefined && last.value === value && !last.isMixed) runs[runs.length - 1] = { ...last, toNs: timeNs };
  else runs.push({ value, fromNs: timeNs, toNs: timeNs, isMixed: false });
  if (runs.length > MAX_RUNS) runs.splice(0, runs.length, ...paired(runs));
}

/** Joins two runs to one each. */
function paired(runs: readonly StateRun[]): StateRun[] {
  return runs.flatMap((run, place) => {
    const next = runs[place + 1];
    if (place % 2 === 1) return [];
    return [next === undefined ? run : { ...run, toNs: next.toNs, isMixed: run.isMixed || next.isMixed || next.value !== run.value }];
  });
}

/** Returns the runs of a field in all parts, in order; a run that two adjacent parts share is one. */
export function runsOf(parts: readonly (FilePart & { readonly content: StateRuns })[], field: string): StateRun[] {
  const runs: StateRun[] = [];
  for (const [number, part] of parts.entries()) {
    const own = part.content.byField.get(field) ?? [];
    const before = parts[number - 1];
    const last = runs.at(-1);
    const first = own[0];
    const isAdjacent = before !== undefined && before.fileId === part.fileId && before.toNs + 1n === part.fromNs;
    if (isAdjacent && last !== undefined && first !== undefined && last.value === first.value && !last.isMixed && !first.isMixed) {
      runs[runs.length - 1] = { ...last, toNs: first.toNs };
      runs.push(...own.slice(1));
    } else runs.push(...own);
  }
  return runs;
}

/** A part of a row, as shares of its width. */
export interface Bar {
  readonly from: number;
  readonly to: number;
  /** Null where several values are too close to be told apart. */
  readonly run: StateRun | null;
}

/** Returns when the value of a run ends: at the next run, where nothing is known, or at its last message. */
function endOf(runs: readonly StateRun[], place: number, unread: readonly Span[]): bigint {
  const [run, next] = [runs[place], runs[place + 1]];
  if (run === undefined) return 0n;
  if (next === undefined) return run.toNs;
  const gap = unread.find(({ fromNs }) => fromNs > run.toNs && fromNs < next.fromNs);
  return gap === undefined ? next.fromNs : run.toNs;
}

/** Returns the bars of runs in a time window. A value is valid until the next message; `unread` has gaps in between. */
export function barsOf(runs: readonly StateRun[], { fromNs, toNs }: Span, pixels: number, unread: readonly Span[] = []): Bar[] {
  const bars: Bar[] = [];
  const whole = Math.max(1, Number(toNs - fromNs));
  const share = (timeNs: bigint): number => Math.max(0, Math.min(1, Number(timeNs - fromNs) / whole));
  const least = 1.5 / Math.max(1, pixels);
  for (const [number, run] of runs.entries()) {
    const endNs = endOf(runs, number, unread);
    if (endNs < fromNs || run.fromNs > toNs) continue;
    const [from, to] = [share(run.fromNs), share(endNs)];
    const last = bars.at(-1);
    if (last !== undefined && to - last.from < least && from - last.to < least) bars[bars.length - 1] = { from: last.from, to, run: last.run?.value === run.value ? last.run : null };
    else bars.push({ from, to: Math.max(to, Math.min(1, from + least)), run: run.isMixed ? null : run });
  }
  return bars;
}

/** Returns the run that is valid at a time; null where it is before the first, or where `unread` is between. */
export function runAt(runs: readonly StateRun[], timeNs: bigint, unread: readonly Span[] = []): StateRun | null {
  const run = runs[placeOf(runs, timeNs)];
  return run === undefined || unread.some(({ fromNs }) => fromNs > run.toNs && fromNs <= timeNs) ? null : run;
}

/** Returns how long the value of a run lasts, in nanoseconds. */
export function durationNs(runs: readonly StateRun[], run: StateRun, unread: readonly Span[] = []): bigint {
  return endOf(runs, runs.indexOf(run), unread) - run.fromNs;
}

/** Returns the time of the change after or before a time; null where there is none. */
export function changeFrom(runs: readonly StateRun[], timeNs: bigint, which: "next" | "previous"): bigint | null {
  const place = placeOf(runs, timeNs);
  if (which === "next") return runs[place + 1]?.fromNs ?? null;
  const isAtStart = runs[place]?.fromNs === timeNs;
  return runs[isAtStart ? place - 1 : place]?.fromNs ?? null;
}

/** The place of the last run that begins at or before a time; -1 where all are later. */
function placeOf(runs: readonly StateRun[], timeNs: bigint): number {
  let [low, high] = [0, runs.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((runs[middle]?.fromNs ?? timeNs) <= timeNs) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

const DISCRETE = /^(bool|u?int(8|16|32)|string|wstring|byte|char)$/;
const LATER = /(^|\.)(header|stamp|seq|frame_id|child_frame_id)(\.|$)|covariance/;

/** Returns the type of a field; null where the definition is not known. */
function typeOf(types: FieldTypes | null, field: string): FieldTypes[string] | null {
  return types?.[field.replaceAll(/\[\d+\]/g, "[]")] ?? null;
}

/** Returns the fields that a timeline offers, by the first message; those that change least often are not known yet. */
export function offeredFields(first: States, types: FieldTypes | null): string[] {
  const fields = Object.keys(first).filter((field) => types === null || DISCRETE.test(typeOf(types, field)?.type ?? "string"));
  return fields.toSorted((a, b) => Number(LATER.test(a)) - Number(LATER.test(b)));
}

/** Returns the fields that are shown: the selected ones, else those with named values, truth values and texts, else the first. */
export function shownFields(offered: readonly string[], selected: readonly string[], first: States, types: FieldTypes | null): string[] {
  const available = selected.filter((field) => offered.includes(field));
  if (available.length > 0) return available.slice(0, MAX_ROWS);
  const plain = offered.filter((field) => !LATER.test(field));
  const best = plain.filter((field) => typeof first[field] !== "number" || Object.keys(typeOf(types, field)?.names ?? {}).length > 0);
  return best.length > 0 ? best.slice(0, 4) : plain.slice(0, 2);
}

/** Returns a value as text: the name of its constant with the number, or the value. */
export function stateText(types: FieldTypes | null, field: string, value: State): string {
  const name = typeOf(types, field)?.names[String(value)];
  if (name !== undefined) return `${name} (${value})`;
  return value === "" ? "“”" : String(value);
}

const COLOURS = 6;

/** Returns the number of a value's colour: 0 for false, else from 1 on, in the order in which the values come. */
export function colourOf(runs: readonly StateRun[]): ReadonlyMap<State, number> {
  const colours = new Map<State, number>();
  for (const { value } of runs) if (!colours.has(value)) colours.set(value, value === false ? 0 : (colours.size % COLOURS) + 1);
  return colours;
}
