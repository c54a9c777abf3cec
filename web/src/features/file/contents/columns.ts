// Curves and paths of numeric columns: which column is the time, what is drawn by default, and the points.
import type { NumericColumn, Table } from "./delimited";
import { CurveCollector, MAX_POINTS, type Curves } from "@/recordings/curves/curves";

const TIME = /^#?\s*(t|time|times|timestamp|stamp|sec|secs|seconds|.*_(time|timestamp|stamp)|(time|timestamp|stamp)_\w+)$/i;
const UNIT = /[[(_ ](ns|us|ms|s|sec|nsec|nanoseconds|microseconds|milliseconds|seconds)[\])]?$/i;
const SECONDS: Readonly<Record<string, number>> = { n: 1e-9, u: 1e-6, m: 1e-3, s: 1 };
/** The latest time that nanoseconds of 64 bits hold, in seconds. */
const LATEST_S = 2 ** 63 / 1e9;
const DEFAULT_CURVES = 3;

/** The name without its unit. */
function bare(name: string): string {
  return name.replace(/\s*[[(].*$/, "").trim();
}

/** Returns the column that is a time; null where none is. */
export function timeColumn(columns: readonly NumericColumn[]): NumericColumn | null {
  return columns.find(({ name }) => TIME.test(bare(name))) ?? null;
}

/** Returns how many seconds the unit of a time is: by the name, else the largest in which the first time is before 2262. */
export function secondsPerUnit({ name, values }: NumericColumn): number {
  const unit = UNIT.exec(name)?.[1]?.toLowerCase();
  const known = unit === undefined ? undefined : SECONDS[unit.startsWith("nano") ? "n" : unit.startsWith("micro") ? "u" : (unit[0] ?? "s")];
  if (known !== undefined) return known;
  const first = Math.abs(values.find((value) => Number.isFinite(value) && value !== 0) ?? 0);
  return [1, 1e-3, 1e-6].find((seconds) => first * seconds < LATEST_S) ?? 1e-9;
}

/** Returns the columns to draw: the selected ones that exist, else the first ones that are not the axis. */
export function drawnColumns(columns: readonly NumericColumn[], selected: readonly string[], axis: NumericColumn | null): readonly NumericColumn[] {
  const chosen = columns.filter(({ name }) => selected.includes(name));
  return chosen.length > 0 ? chosen : columns.filter((column) => column !== axis).slice(0, DEFAULT_CURVES);
}

/** Returns the curves of columns over an axis: seconds since its first value for a time; the number of the row without one. */
export function curvesOf(columns: readonly NumericColumn[], axis: NumericColumn | null, isTime: boolean): Curves {
  const length = columns[0]?.values.length ?? 0;
  const scale = axis !== null && isTime ? secondsPerUnit(axis) : 1;
  const first = axis !== null && isTime ? (axis.values.find((value) => Number.isFinite(value)) ?? 0) : 0;
  const positions = Array.from({ length }, (_, row) => (axis === null ? row + 1 : ((axis.values[row] ?? NaN) - first) * scale));
  const rows = positions.flatMap((position, row) => (Number.isFinite(position) ? [row] : [])).sort((a, b) => (positions[a] ?? 0) - (positions[b] ?? 0));
  const collector = new CurveCollector(columns.length, positions[rows[0] ?? 0] ?? 0, positions[rows.at(-1) ?? 0] ?? 0);
  for (const row of rows) collector.add(positions[row] ?? 0, columns.map(({ values }) => finite(values[row])));
  return collector.curves();
}

function finite(value: number | undefined): number | null {
  return value !== undefined && Number.isFinite(value) ? value : null;
}

/** Returns the columns of a position: of a trajectory, x and y, or x and z where the camera looks along z (KITTI). */
export function positionColumns({ numeric }: Table): readonly [NumericColumn, NumericColumn] | null {
  const axis = (letter: string): NumericColumn | undefined => {
    const pattern = new RegExp(`^(t?${letter}|p_?${letter}|p_\\w+_${letter}|pos(ition)?[._]?${letter}|.*position[._]${letter})$`, "i");
    return numeric.find(({ name }) => pattern.test(bare(name)));
  };
  const isKitti = numeric[0]?.name === "r11";
  const [x, y] = [axis("x"), axis(isKitti ? "z" : "y")];
  const [first, second] = numeric.filter((column) => column !== timeColumn(numeric));
  if (x !== undefined && y !== undefined) return [x, y];
  return first === undefined || second === undefined ? null : [first, second];
}

export interface Path {
  /** Commands of an SVG path: x to the right, y up, from the first point on. */
  readonly commands: string;
  readonly start: readonly [number, number];
  readonly end: readonly [number, number];
  readonly box: { readonly x: number; readonly y: number; readonly width: number; readonly height: number };
  /** How far it reaches to the right and up, in the unit of the columns. */
  readonly extent: readonly [number, number];
  readonly points: number;
}

/** Returns the path of two columns, thinned to MAX_POINTS; null without points. */
export function pathOf(x: NumericColumn, y: NumericColumn): Path | null {
  const rows = x.values.flatMap((value, row) => (Number.isFinite(value) && Number.isFinite(y.values[row]) ? [row] : []));
  const step = Math.ceil(rows.length / MAX_POINTS);
  const shown = rows.filter((_, at) => at % step === 0 || at === rows.length - 1);
  const [originX, originY] = [x.values[rows[0] ?? 0] ?? 0, y.values[rows[0] ?? 0] ?? 0];
  const points = shown.map((row) => [(x.values[row] ?? 0) - originX, originY - (y.values[row] ?? 0)] as const);
  const [start, end] = [points[0], points.at(-1)];
  if (start === undefined || end === undefined) return null;
  const [left, right, top, bottom] = points.reduce<readonly [number, number, number, number]>(
    ([west, east, north, south], [across, down]) => [Math.min(west, across), Math.max(east, across), Math.min(north, down), Math.max(south, down)],
    [0, 0, 0, 0],
  );
  const margin = Math.max(right - left, bottom - top, 1e-9) * 0.06;
  const box = { x: left - margin, y: top - margin, width: right - left + 2 * margin, height: bottom - top + 2 * margin };
  const commands = points.map(([across, down], at) => `${at === 0 ? "M" : "L"}${across.toPrecision(7)} ${down.toPrecision(7)}`).join("");
  return { commands, start, end, box, extent: [right - left, bottom - top], points: rows.length };
}
