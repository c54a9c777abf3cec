// All files of a mission on one axis: which are beside each other, where there is none, and how that is drawn.
import type { TimelineFile } from "./queries";

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
  readonly mostAtOnce: number;
  readonly coveredNs: number;
  /** Files that have no time, or one that cannot be true. */
  readonly without: number;
}

export const MOST_LANES = 8;
const LEAST_GAP_NS = 1e9;
/** Parts of the axis that are told apart in drawing. */
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
    if (item.startNs - reached >= LEAST_GAP_NS) gaps.push({ startNs: reached, endNs: item.startNs });
    coveredNs += Math.max(0, item.endNs - Math.max(item.startNs, reached));
    reached = Math.max(reached, item.endNs);
    place(lanes, item);
  }
  return { lanes, gaps, mostAtOnce: mostOf(placed), coveredNs, without: files.length - placed.length };
}

function place(lanes: Placed[][], item: Placed): void {
  const free = lanes.find((lane) => (lane.at(-1)?.endNs ?? -Infinity) <= item.startNs);
  if (free !== undefined) free.push(item);
  else if (lanes.length < MOST_LANES) lanes.push([item]);
  else lanes.at(-1)?.push(item);
}

/** How many files go on at once, at most. `placed` come by their beginning. */
function mostOf(placed: readonly Placed[]): number {
  const ends = placed.map((item) => item.endNs).sort((one, other) => one - other);
  let [most, over] = [0, 0];
  placed.forEach((item, begun) => {
    while ((ends[over] ?? Infinity) <= item.startNs && over < begun) over += 1;
    most = Math.max(most, begun + 1 - over);
  });
  return most;
}

/** Returns the bars of one lane as a path in a box of `COLUMNS` by 1, those of which `isWanted`; neighbours become one. */
export function barsPath(lane: readonly Placed[], axis: Span, isWanted: (file: TimelineFile) => boolean): string {
  const scale = COLUMNS / Math.max(1, axis.endNs - axis.startNs);
  let path = "";
  let [from, to] = [-1, -1];
  const flush = () => {
    if (to > from) path += `M${from} 0H${to}V1H${from}Z`;
  };
  for (const item of lane) {
    if (!isWanted(item.file)) continue;
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
