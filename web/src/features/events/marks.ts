// Marks on a time axis: events, findings and gaps as paths, and the mark at a place.
import type { FindingWithTime, MissionEvent } from "./events";

/** The part of the time that the axis shows, in nanoseconds. */
export interface Axis {
  readonly startNs: number;
  readonly endNs: number;
}

export type MarkKind = "event" | "error" | "warning" | "info";

export interface Mark {
  readonly kind: MarkKind;
  readonly label: string;
  readonly colour: string | null;
  readonly startNs: number;
  readonly endNs: number;
}

/** Heights of the two lanes, in pixels: events above, findings below. */
export const EVENT_PX = 10;
export const FINDING_PX = 9;
const TICK_PX = 3;
const HALF_PX = 4;

/** Returns the marks of events and findings by time; a finding that became an event is that event. */
export function marksOf(events: readonly MissionEvent[], findings: readonly FindingWithTime[]): Mark[] {
  const ofEvents = events.map(({ name, colour, start_ns: startNs, end_ns: endNs }): Mark => ({ kind: "event", label: name, colour, startNs, endNs: endNs ?? startNs }));
  const ofFindings = openFindings(events, findings).map(({ finding }): Mark => (
    { kind: finding.severity, label: finding.message, colour: null, startNs: finding.time_ns, endNs: finding.time_ns }
  ));
  return [...ofEvents, ...ofFindings].toSorted((a, b) => a.startNs - b.startNs);
}

/** Returns the findings that did not become events. */
export function openFindings(events: readonly MissionEvent[], findings: readonly FindingWithTime[]): FindingWithTime[] {
  const made = new Set(events.map(({ finding_id: id }) => id));
  return findings.filter(({ id }) => !made.has(id));
}

/** Returns where a time is on an axis of some width. */
export function xOf(timeNs: number, { startNs, endNs }: Axis, widthPx: number): number {
  return (widthPx * (timeNs - startNs)) / Math.max(1, endNs - startNs);
}

export interface MarkPath {
  readonly kind: MarkKind;
  readonly colour: string | null;
  readonly path: string;
}

/** Returns one path for each kind and colour of marks that are on the axis: bars of events, and signs of findings. */
export function pathsOf(marks: readonly Mark[], axis: Axis, widthPx: number): MarkPath[] {
  const paths = new Map<string, { kind: MarkKind; colour: string | null; parts: string[] }>();
  for (const mark of marks) {
    if (mark.endNs < axis.startNs || mark.startNs > axis.endNs) continue;
    const key = `${mark.kind} ${mark.colour}`;
    const { kind, colour } = mark;
    const path = paths.get(key) ?? { kind, colour, parts: [] };
    path.parts.push(shapeOf(mark, axis, widthPx));
    paths.set(key, path);
  }
  return [...paths.values()].map(({ kind, colour, parts }) => ({ kind, colour, path: parts.join("") }));
}

function shapeOf({ kind, startNs, endNs }: Mark, axis: Axis, widthPx: number): string {
  const from = Math.max(0, xOf(startNs, axis, widthPx));
  if (kind === "event") {
    const to = Math.min(widthPx, Math.max(xOf(endNs, axis, widthPx), from + TICK_PX));
    return `M${from.toFixed(1)} 1H${to.toFixed(1)}V${EVENT_PX - 1}H${from.toFixed(1)}Z`;
  }
  const top = EVENT_PX;
  const bottom = EVENT_PX + FINDING_PX - 1;
  const middle = (top + bottom) / 2;
  const [left, x, right] = [from - HALF_PX, from, from + HALF_PX].map((at) => at.toFixed(1));
  if (kind === "error") return `M${x} ${top}L${right} ${bottom}H${left}Z`;
  if (kind === "warning") return `M${x} ${top}L${right} ${middle}L${x} ${bottom}L${left} ${middle}Z`;
  return `M${(from - 1).toFixed(1)} ${top}h2V${bottom}h-2Z`;
}

/** Returns the parts of an axis between recorded spans. */
export function gapsOf(recorded: readonly { readonly fromNs: bigint; readonly toNs: bigint }[]): Axis[] {
  return recorded.slice(1).map(({ fromNs }, place) => ({ startNs: Number(recorded[place]?.toNs), endNs: Number(fromNs) }));
}

/** Returns the mark at a place of the axis, or the nearest one that is at most `nearPx` away. Findings have the lower lane. */
export function markAt(marks: readonly Mark[], axis: Axis, widthPx: number, place: { readonly xPx: number; readonly yPx: number }, nearPx: number): Mark | null {
  const isEvents = place.yPx < EVENT_PX;
  let best: { readonly mark: Mark; readonly rank: number } | null = null;
  for (const mark of marks) {
    const [from, to] = [xOf(mark.startNs, axis, widthPx), xOf(mark.endNs, axis, widthPx)];
    const distance = Math.max(0, from - place.xPx, place.xPx - to);
    if (distance > nearPx) continue;
    // A moment is preferred to a span around it, and the pointed lane to the other.
    const rank = distance + (to - from > nearPx ? nearPx : 0) + ((mark.kind === "event") === isEvents ? 0 : nearPx);
    if (best === null || rank <= best.rank) best = { mark, rank };
  }
  return best?.mark ?? null;
}

/** Returns the next mark after a time, or the previous one before it. Times within `nearNs` are the same. */
export function neighbour(marks: readonly Mark[], which: "next" | "previous", timeNs: number, nearNs: number): Mark | undefined {
  return which === "next" ? marks.find(({ startNs }) => startNs > timeNs + nearNs) : marks.findLast(({ startNs }) => startNs < timeNs - nearNs);
}
