// The layout of files on a time axis (lanes, gaps, bars), and the filter and gaps of topics.
import type { MissionTopic, TimelineFile, Topics } from "./queries";
import type { RouteLocationRaw } from "vue-router";

export interface Span {
  readonly startNs: number;
  readonly endNs: number;
}

export interface Placed extends Span {
  readonly file: TimelineFile;
}

export interface Lanes {
  /** Files above each other do not overlap; those that found no room any more are in the last one. */
  readonly lanes: readonly (readonly Placed[])[];
  readonly gaps: readonly Span[];
  readonly maxSimultaneous: number;
  readonly coveredNs: number;
  /** Files that have no time, or one that cannot be true. */
  readonly without: number;
}

export const MAX_LANES = 8;
const MIN_GAP_NS = 1e9;
/** The resolution of the drawing. */
export const COLUMNS = 1600;

/** Places files on an axis. */
export function lanesOf(files: readonly TimelineFile[], axis: Span): Lanes {
  const placed: Placed[] = [];
  for (const file of files) {
    const { start_ns: startNs, end_ns: endNs } = file;
    if (startNs !== null && endNs !== null && startNs <= axis.endNs && endNs >= axis.startNs) placed.push({ file, startNs, endNs });
  }
  placed.sort((one, other) => one.startNs - other.startNs || one.endNs - other.endNs);
  const lanes: Placed[][] = [];
  const gaps: Span[] = [];
  let [reached, coveredNs] = [axis.startNs, 0];
  for (const item of placed) {
    if (item.startNs - reached >= MIN_GAP_NS) gaps.push({ startNs: reached, endNs: item.startNs });
    coveredNs += Math.max(0, item.endNs - Math.max(item.startNs, reached));
    reached = Math.max(reached, item.endNs);
    place(lanes, item);
  }
  return { lanes, gaps, maxSimultaneous: mostOf(placed), coveredNs, without: files.length - placed.length };
}

function place(lanes: Placed[][], item: Placed): void {
  const free = lanes.find((lane) => (lane.at(-1)?.endNs ?? -Infinity) <= item.startNs);
  if (free !== undefined) free.push(item);
  else if (lanes.length < MAX_LANES) lanes.push([item]);
  else lanes.at(-1)?.push(item);
}

/** The largest number of simultaneous files. `placed` is sorted by start. */
function mostOf(placed: readonly Placed[]): number {
  const ends = placed.map((item) => item.endNs).sort((one, other) => one - other);
  let [most, over] = [0, 0];
  placed.forEach((item, begun) => {
    while ((ends[over] ?? Infinity) <= item.startNs && over < begun) over += 1;
    most = Math.max(most, begun + 1 - over);
  });
  return most;
}

/** Returns the bars of one lane that pass a filter as a path in a box of `COLUMNS` by 1. Adjacent bars are merged. */
export function barsPath(lane: readonly Placed[], axis: Span, isIncluded: (file: TimelineFile) => boolean): string {
  const scale = COLUMNS / Math.max(1, axis.endNs - axis.startNs);
  let path = "";
  let [from, to] = [-1, -1];
  const flush = () => {
    if (to > from) path += `M${from} 0H${to}V1H${from}Z`;
  };
  for (const item of lane) {
    if (!isIncluded(item.file)) continue;
    const start = Math.min(COLUMNS - 1, Math.max(0, Math.floor((item.startNs - axis.startNs) * scale)));
    const end = Math.max(start + 1, Math.min(COLUMNS, Math.round((item.endNs - axis.startNs) * scale)));
    if (start <= to - 1 || (start === to && end - start <= 1)) to = Math.max(to, end);
    else {
      flush();
      [from, to] = [start, end];
    }
  }
  flush();
  return path;
}

/** Returns the file at a time, or the one nearest to it within some distance. */
export function fileAt(lane: readonly Placed[], atNs: number, withinNs: number): Placed | null {
  let nearest: Placed | null = null;
  let distance = withinNs;
  for (const item of lane) {
    if (item.startNs - withinNs > atNs) break;
    const away = atNs < item.startNs ? item.startNs - atNs : Math.max(0, atNs - item.endNs);
    if (away <= distance) [nearest, distance] = [item, away];
    if (away === 0) return item;
  }
  return nearest;
}

/** Returns the number and the share of gaps between the first and the last message of a topic. */
export function silences(counts: readonly number[]): { readonly count: number; readonly share: number } {
  const first = counts.findIndex((item) => item > 0);
  const last = counts.findLastIndex((item) => item > 0);
  let [count, empty] = [0, 0];
  for (let at = first; at >= 0 && at <= last; at += 1) {
    if (counts[at] !== 0) continue;
    empty += 1;
    if (counts[at - 1] !== 0) count += 1;
  }
  return { count, share: empty === 0 ? 0 : empty / (last - first + 1) };
}

/** Returns the topics in whose name or type a text occurs. */
export function matching(topics: readonly MissionTopic[], text: string): readonly MissionTopic[] {
  const lowered = text.toLocaleLowerCase();
  if (lowered === "") return topics;
  return topics.filter(({ name, message_type: type }) => name.toLocaleLowerCase().includes(lowered) || type?.toLocaleLowerCase().includes(lowered));
}

/** Sorts topics by `name`, `count`, `rate` or `gap`; a minus sign reverses the order. */
export function sorted(topics: readonly MissionTopic[], order: string): readonly MissionTopic[] {
  const [key, direction] = order.startsWith("-") ? [order.slice(1), -1] : [order, 1];
  const values: Readonly<Record<string, (topic: MissionTopic) => number | null>> = {
    count: (topic) => topic.count,
    rate: (topic) => topic.rate_hz,
    gap: (topic) => topic.longest_gap_ns,
  };
  const value = values[key];
  if (value === undefined) return direction === 1 ? topics : [...topics].reverse();
  return [...topics].sort((one, other) => direction * ((value(one) ?? -1) - (value(other) ?? -1)));
}

/** Returns the page of the first file that contains a topic; null if none is known. */
export function firstPlace(topic: MissionTopic, { recordings }: Topics, files: ReadonlyMap<string, TimelineFile>): RouteLocationRaw | null {
  const [first] = topic.recordings;
  const recording = recordings[first?.[0] ?? -1];
  const file = recording === undefined ? undefined : files.get(recording.id);
  return file === undefined ? null : { name: "file", params: { fileId: file.id }, query: { topic: topic.name } };
}

/** Returns for each recording the file of it that begins first. */
export function firstFiles(files: readonly TimelineFile[]): Map<string, TimelineFile> {
  const byId = new Map<string, TimelineFile>();
  for (const file of files) {
    if (file.recording_id === null || file.start_ns === null) continue;
    const known = byId.get(file.recording_id);
    if (known?.start_ns === undefined || known.start_ns === null || file.start_ns < known.start_ns) byId.set(file.recording_id, file);
  }
  return byId;
}
