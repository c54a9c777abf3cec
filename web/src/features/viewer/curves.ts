// Curves of several topics on one axis: which parts were read, and their points side by side.
import { MAX_BYTES_UNCONFIRMED } from "@/recordings/limits";
import type { Span } from "@/recordings/formats/recording";
import type { DrawnCurves } from "@/recordings/protocol";
import type { PlotCurve } from "./plot_curves";
import type { SourceFile } from "./sources";

/** A part of a file that was read. */
export interface FilePart extends Span {
  readonly fileId: string;
}

/** A part of a file whose curves were read. */
export interface Segment extends FilePart {
  /** Seconds since the beginning of the viewer's time. */
  readonly seconds: readonly number[];
  /** By column: a field, or what is computed from each message. */
  readonly values: readonly (readonly (number | null | undefined)[])[];
  readonly messages: number;
  /** Whether these are all points, or the extremes of slices. */
  readonly isWhole: boolean;
  /** What the topic has in the whole file, in bytes. */
  readonly topicBytes: number;
  /** Messages with a log time although the time of headers was requested. */
  readonly unstamped: number;
}

/** What a plot knows of one of its topics. */
export interface SeriesState {
  readonly curves: readonly PlotCurve[];
  /** What is read, by which the values of segments are sorted. */
  readonly columns: readonly string[];
  /** The fields and vectors that the topic offers. */
  readonly fields: readonly string[];
  readonly segments: readonly Segment[];
  /** Curves of the previews, in the parts that were not read. */
  readonly rough: readonly Segment[];
  readonly unread: readonly Span[];
  readonly wholeBytes: number;
  readonly isReading: boolean;
  readonly readAll: () => void;
}

/** What a plot reads unasked of one topic, and around the play head. */
export const PLOT_BYTES = MAX_BYTES_UNCONFIRMED / 2;
export const AROUND_BYTES = 8 * 2 ** 20;
/** How long before a segment the curve is broken. */
const BREAK_SECONDS = 1e-6;
const AROUND_BEFORE_NS = 2_000_000_000n;
const AROUND_AFTER_NS = 15_000_000_000n;

/** Returns the segment of curves that a file gave; `offsetSeconds` is the start of its recording on the axis. */
export function segmentOf(fileId: string, requested: Span, curves: DrawnCurves, offsetSeconds: number): Segment {
  const untilNs = curves.untilNs < requested.toNs ? curves.untilNs : requested.toNs;
  const { values, messages, isWhole, topicBytes, unstamped } = curves;
  const seconds = curves.seconds.map((second) => second + offsetSeconds);
  return { fileId, fromNs: requested.fromNs, toNs: untilNs, seconds, values, messages, isWhole, topicBytes, unstamped };
}

/** Returns the segment of a part of a file that has no message of the topic. */
export function emptySegment(fileId: string, part: Span): Segment {
  return { ...part, fileId, seconds: [], values: [], messages: 0, isWhole: true, topicBytes: 0, unstamped: 0 };
}

/** Returns the parts of a file that no segment covers, in order. */
export function unreadParts({ id, span }: SourceFile, segments: readonly FilePart[]): Span[] {
  const own = segments.filter(({ fileId }) => fileId === id).toSorted((a, b) => (a.fromNs < b.fromNs ? -1 : 1));
  const parts: Span[] = [];
  let fromNs = span.fromNs;
  for (const segment of own) {
    if (segment.fromNs > fromNs) parts.push({ fromNs, toNs: segment.fromNs - 1n });
    if (segment.toNs >= fromNs) fromNs = segment.toNs + 1n;
  }
  return fromNs <= span.toNs ? [...parts, { fromNs, toNs: span.toNs }] : parts;
}

/** Returns the bytes of a topic in the files that have unread parts. Of files that were not opened, by its share of the others. */
export function bytesToReadAll(files: readonly SourceFile[], segments: readonly Segment[]): number {
  const known = new Map(segments.map(({ fileId, topicBytes }) => [fileId, topicBytes]));
  const openedBytes = files.reduce((sum, { id, size_bytes: size }) => sum + (known.has(id) ? size : 0), 0);
  const share = [...known.values()].reduce((sum, bytes) => sum + bytes, 0) / Math.max(1, openedBytes);
  const isUnread = (file: SourceFile): boolean => unreadParts(file, segments).length > 0;
  return files.filter(isUnread).reduce((sum, { id, size_bytes: size }) => sum + (known.get(id) ?? Math.round(share * size)), 0);
}

/** Returns what is to be read around a time, within an unread part; null where the time lies in none. */
export function partAround(unread: readonly Span[], timeNs: bigint): Span | null {
  const part = unread.find(({ fromNs, toNs }) => timeNs >= fromNs && timeNs <= toNs);
  if (part === undefined) return null;
  const fromNs = timeNs - AROUND_BEFORE_NS > part.fromNs ? timeNs - AROUND_BEFORE_NS : part.fromNs;
  const toNs = timeNs + AROUND_AFTER_NS < part.toNs ? timeNs + AROUND_AFTER_NS : part.toNs;
  return { fromNs, toNs };
}

/** Returns what of unread parts lies in a span. */
export function partsWithin(unread: readonly Span[], { fromNs, toNs }: Span): Span[] {
  const parts = unread.map((part) => ({ fromNs: part.fromNs > fromNs ? part.fromNs : fromNs, toNs: part.toNs < toNs ? part.toNs : toNs }));
  return parts.filter((part) => part.fromNs <= part.toNs);
}

/** A part is read again where it is at most this share of one that is drawn by its extremes. */
const DETAIL_SHARE = 0.5;

/** Returns what of a span is drawn by extremes, which reading it alone would show in more detail. */
export function partsToDetail(fileId: string, segments: readonly Segment[], span: Span): Span[] {
  return segments.flatMap((segment) => {
    if (segment.fileId !== fileId || segment.isWhole) return [];
    const [part] = partsWithin([segment], span);
    const isPart = part !== undefined && Number(part.toNs - part.fromNs) <= DETAIL_SHARE * Number(segment.toNs - segment.fromNs);
    return isPart ? [part] : [];
  });
}

/** Returns segments with one that was read again in their place: what they have in its time is left out. */
export function withDetail(segments: readonly Segment[], detail: Segment, secondsOf: (timeNs: bigint) => number): Segment[] {
  // Stamps of headers lie elsewhere than the log times of their messages.
  const [from, to] = [detail.seconds[0] ?? secondsOf(detail.fromNs), detail.seconds.at(-1) ?? secondsOf(detail.toNs)];
  const others = segments.flatMap((segment) => {
    const [overlap] = partsWithin([segment], detail);
    if (segment.fileId !== detail.fileId || overlap === undefined) return [segment];
    const before = segmentWithin({ ...segment, toNs: detail.fromNs - 1n }, (second) => second < from);
    const after = segmentWithin({ ...segment, fromNs: detail.toNs + 1n }, (second) => second > to);
    const remaining = [before, after].filter(({ fromNs, toNs }) => fromNs <= toNs);
    // What both parts have together is counted in the first.
    const counts = { messages: segment.messages - detail.messages, unstamped: segment.unstamped - detail.unstamped };
    const none = { messages: 0, unstamped: 0 };
    return remaining.map((part, place) => ({ ...part, ...(place === 0 ? counts : none) }));
  });
  return [...others, detail];
}

function segmentWithin(segment: Segment, isWithin: (second: number) => boolean): Segment {
  const rows = segment.seconds.flatMap((second, row) => (isWithin(second) ? [row] : []));
  return { ...segment, seconds: rows.map((row) => segment.seconds[row] ?? 0), values: segment.values.map((curve) => rows.map((row) => curve[row])) };
}

export interface Aligned {
  readonly seconds: readonly number[];
  /** By curve. `undefined`: no point at this time; `null`: the curve is broken. */
  readonly values: readonly (readonly (number | null | undefined)[])[];
}

/** Points of curves that have one list of times. */
interface Run {
  readonly seconds: readonly number[];
  readonly first: number;
  readonly values: readonly (readonly (number | null | undefined)[] | undefined)[];
}

/** Returns the curves of several topics with one list of times. A curve is broken between two segments with a gap. */
export function aligned(topics: readonly { readonly curves: number; readonly segments: readonly Segment[] }[]): Aligned {
  const runs: Run[] = [];
  let total = 0;
  for (const { curves, segments } of topics) {
    runs.push(...runsOf(segments, total, curves));
    total += curves;
  }
  const seconds = timesOf(runs);
  const rows = Array.from({ length: total }, () => Array.from<number | null | undefined>({ length: seconds.length }));
  for (const run of runs) {
    let row = firstAfter(seconds, run.seconds[0] ?? 0) - 1;
    run.seconds.forEach((second, place) => {
      row = rowOf(seconds, second, row);
      run.values.forEach((values, curve) => put(rows[run.first + curve], row, values?.[place]));
    });
  }
  return { seconds, values: rows };
}

/** Returns the segments of a topic in order, and the breaks before those with a gap. */
function runsOf(segments: readonly Segment[], first: number, curves: number): Run[] {
  const inOrder = segments.toSorted((a, b) => (a.fromNs < b.fromNs ? -1 : 1));
  return inOrder.flatMap(({ fromNs, seconds, values }, place): Run[] => {
    const [start, previous] = [seconds[0], inOrder[place - 1]];
    const isApart = previous !== undefined && start !== undefined && fromNs > previous.toNs + 1n;
    const gap = isApart ? [{ seconds: [start - BREAK_SECONDS], first, values: Array.from({ length: curves }, () => [null]) }] : [];
    return [...gap, { seconds, first, values: values.slice(0, curves) }];
  });
}

/** Returns the times of all points, each once, in order. */
function timesOf(runs: readonly Run[]): readonly number[] {
  const all = new Float64Array(runs.reduce((count, { seconds }) => count + seconds.length, 0));
  let end = 0;
  for (const { seconds } of runs) {
    all.set(seconds, end);
    end += seconds.length;
  }
  return [...all.sort().filter((second, place) => second !== all[place - 1])];
}

/** Returns the row of a time, which is usually at `from` or soon after it. */
function rowOf(seconds: readonly number[], second: number, from: number): number {
  let row = from;
  if ((seconds[row] ?? Infinity) > second) return firstAfter(seconds, second) - 1; // stamps need not be in order
  while ((seconds[row] ?? Infinity) < second) row += 1;
  return row;
}

function put(values: (number | null | undefined)[] | undefined, row: number, value: number | null | undefined): void {
  // Of two messages at one time, the second has no derivative: the first one's stays.
  if (values !== undefined && value !== undefined && (value !== null || values[row] === undefined)) values[row] = value;
}

/** Returns the first row after a time. */
function firstAfter(seconds: readonly number[], second: number): number {
  let [low, high] = [0, seconds.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((seconds[middle] ?? 0) <= second) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Returns the end of the last unread part that begins at or before a time; null where there is none. */
export function unreadUntil(unread: readonly Span[], timeNs: bigint): bigint | null {
  return unread.reduce<bigint | null>((latest, { fromNs, toNs }) => (fromNs <= timeNs && (latest === null || toNs > latest) ? toNs : latest), null);
}

/** Returns the last value of a curve from `since` up to a time, in seconds; null where there is none. */
export function valueAt({ seconds, values }: Aligned, curve: number, second: number, since = -Infinity): number | null {
  for (let row = firstAfter(seconds, second) - 1; row >= 0; row -= 1) {
    if ((seconds[row] ?? 0) < since) return null;
    const value = values[curve]?.[row];
    if (value !== undefined) return value;
  }
  return null;
}
