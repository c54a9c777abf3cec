// The topics of a plot with their curves, and differences between curves of two topics.
import { aligned, valueAt, type Aligned, type Segment, type SeriesState } from "./curves";
import type { Series } from "./layout";
import { curveOf, isDerived, type OtherField } from "./plot_curves";
import { MAX_CURVES } from "@/recordings/limits";

/** A topic of a plot. `first`: the place of its first curve among those of the plot. */
export interface PlotRow {
  readonly series: Series;
  readonly state: SeriesState | undefined;
  readonly first: number;
  readonly count: number;
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

/** Returns all curves of a plot with one list of times. `secondsOf` returns the place of a log time on the axis. */
export function drawnCurves(rows: readonly PlotRow[], secondsOf: (timeNs: bigint) => number): Aligned {
  return aligned(rows.map(({ state, count }) => ({ curves: count, segments: state === undefined ? [] : segmentsOf(state, rows, secondsOf) })));
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
function segmentsOf(state: SeriesState, rows: readonly PlotRow[], secondsOf: (timeNs: bigint) => number): Segment[] {
  const columns = state.curves.map(({ column, minus }) => {
    const other = minus === null ? undefined : stateOf(rows, minus);
    const subtracted = minus === null ? null : whollyRead(other?.segments ?? [], other?.columns.indexOf(minus.field) ?? -1, secondsOf);
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

/** Returns a curve without the segments that have extremes only. */
export function whollyRead(segments: readonly Segment[], column: number, secondsOf: (timeNs: bigint) => number): KnownCurve {
  const whole = segments.filter(({ isWhole }) => isWhole).toSorted((a, b) => (a.fromNs < b.fromNs ? -1 : 1));
  const spans: [bigint, bigint][] = [];
  for (const { fromNs, toNs } of whole) {
    const last = spans.at(-1);
    if (last !== undefined && fromNs <= last[1] + 1n) last[1] = toNs > last[1] ? toNs : last[1];
    else spans.push([fromNs, toNs]);
  }
  const curve = whole.map((segment) => ({ ...segment, values: [segment.values[column] ?? []] }));
  return { ...aligned([{ curves: 1, segments: curve }]), spans: spans.map(([fromNs, toNs]) => [secondsOf(fromNs), secondsOf(toNs)]) };
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
