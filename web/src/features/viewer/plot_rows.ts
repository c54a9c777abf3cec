// The topics of a plot with their curves, and differences between curves of two topics.
import { aligned, valueAt, type Aligned, type Segment, type SeriesState } from "./curves";
import type { Series } from "./layout";
import { curveOf, isDerived, type OtherField } from "./plot_curves";
import { MAX_CURVES } from "@/recordings/limits";
import type { CurveTime } from "@/recordings/protocol";

/** A topic of a plot. `first`: the place of its first curve among those of the plot. */
export interface PlotRow {
  readonly series: Series;
  readonly state: SeriesState | undefined;
  readonly first: number;
  readonly count: number;
}

/** The axis of a plot. `secondsOf` returns the place of a log time on it. */
export interface TimeAxis {
  readonly time: CurveTime;
  readonly secondsOf: (timeNs: bigint) => number;
}

/** Doubles of two recordings may differ at the same nanosecond. */
const HALF_NS = 5e-10;

type Source = Pick<Series, "recording" | "topic">;

export const sourceKey = ({ recording, topic }: Source): string => `${recording} ${topic}`;

export function plotRows(series: readonly Series[], states: ReadonlyMap<string, SeriesState>): PlotRow[] {
  let first = 0;
  return series.map((one) => {
    const state = states.get(sourceKey(one));
    const row = { series: one, state, first, count: state?.curves.length ?? 0 };
    first += row.count;
    return row;
  });
}

/** Returns the fields of a topic that curves of other topics subtract. */
export function operandsOf(series: readonly Series[], source: Source): string[] {
  const others = series.flatMap(({ fields }) => fields.flatMap((field): OtherField | [] => curveOf(field).minus ?? []));
  return [...new Set(others.filter((other) => sourceKey(other) === sourceKey(source)).map(({ field }) => field))].slice(0, MAX_CURVES);
}

/** Returns all curves of a plot with one list of times. */
export function drawnCurves(rows: readonly PlotRow[], axis: TimeAxis): Aligned {
  return aligned(rows.map(({ state, count }) => ({ curves: count, segments: state === undefined ? [] : segmentsOf(state, rows, axis) })));
}

/** Whether a curve misses where only extremes are known, of a preview or of many messages: those of a computed curve are not. */
export function isZoomNeeded(rows: readonly PlotRow[]): boolean {
  return rows.some(({ state }) => {
    const isRough = state?.rough.some(({ seconds }) => seconds.length > 0) === true;
    return state?.curves.some((curve) => {
      if (curve.minus === null) return isRough && isDerived(curve);
      const other = stateOf(rows, curve.minus);
      return isRough || [...state.segments, ...(other?.segments ?? []), ...(other?.rough ?? [])].some(({ isWhole, seconds }) => !isWhole && seconds.length > 0);
    });
  });
}

function stateOf(rows: readonly PlotRow[], source: Source): SeriesState | undefined {
  return rows.find(({ series }) => sourceKey(series) === sourceKey(source))?.state;
}

/** Returns the segments of a topic by its curves instead of by what was read. */
function segmentsOf(state: SeriesState, rows: readonly PlotRow[], axis: TimeAxis): Segment[] {
  const columns = state.curves.map(({ column, minus }) => {
    const other = minus === null ? undefined : stateOf(rows, minus);
    const subtracted = minus === null ? null : whollyRead(other ?? NOTHING_READ, other?.columns.indexOf(minus.field) ?? -1, axis);
    return { place: state.columns.indexOf(column), subtracted };
  });
  return [...state.segments, ...state.rough].map((segment) => ({
    ...segment,
    values: columns.map(({ place, subtracted }) => (subtracted === null ? (segment.values[place] ?? []) : differences(segment, place, subtracted))),
  }));
}

/** A curve where all its messages are known, and where that is, in seconds: only there has it a value that is valid. */
export interface KnownCurve extends Aligned {
  readonly spans: readonly (readonly [from: number, to: number])[];
}

type ReadParts = Pick<SeriesState, "segments" | "unread">;
const NOTHING_READ: ReadParts = { segments: [], unread: [] };

/** Returns a curve without the segments that have extremes only. */
export function whollyRead(parts: ReadParts, column: number, axis: TimeAxis): KnownCurve {
  const whole = parts.segments.filter(({ isWhole }) => isWhole).toSorted((a, b) => (a.fromNs < b.fromNs ? -1 : 1));
  const curve = whole.map((segment) => ({ ...segment, values: [segment.values[column] ?? []] }));
  return { ...aligned([{ curves: 1, segments: curve }]), spans: joined(whole).map((span) => knownSeconds(span, parts, axis)) };
}

/** Joins segments that touch; they are in order. */
function joined(segments: readonly Segment[]): Segment[] {
  const result: Segment[] = [];
  for (const segment of segments) {
    const last = result.at(-1);
    if (last === undefined || segment.fromNs > last.toNs + 1n) result.push(segment);
    else result[result.length - 1] = { ...last, toNs: segment.toNs > last.toNs ? segment.toNs : last.toNs, seconds: [...last.seconds, ...segment.seconds] };
  }
  return result;
}

/** Returns where a curve is known by a part that was read. */
function knownSeconds({ fromNs, toNs, seconds }: Segment, { segments, unread }: ReadParts, { time, secondsOf }: TimeAxis): [number, number] {
  if (time === "log") return [secondsOf(fromNs), secondsOf(toNs)];
  // What was logged behind the part may be stamped within it, but not before its last stamp.
  const [first, last] = [seconds[0] ?? Infinity, seconds.at(-1) ?? -Infinity];
  const isLast = ![...unread, ...segments.filter(({ isWhole }) => !isWhole)].some((other) => other.fromNs > toNs);
  return [first, isLast ? Math.max(last, secondsOf(toNs)) : last];
}

/** Returns a curve of a segment minus the value of another that was valid at the time of each of its points. */
export function differences({ seconds, values, isWhole }: Segment, place: number, subtracted: KnownCurve): (number | null | undefined)[] {
  if (!isWhole) return [];
  return seconds.map((second, row) => {
    const value = values[place]?.[row];
    if (value === null || value === undefined) return value;
    const span = subtracted.spans.find(([from, to]) => second >= from && second <= to);
    const valid = span === undefined ? null : valueAt(subtracted, 0, second + HALF_NS, span[0]);
    return valid === null ? null : value - valid;
  });
}
