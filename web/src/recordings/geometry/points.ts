/** Points in space with values to colour them by. */

import type { Vector } from "./poses";
import { MAX_POINTS } from "../limits";

/** One value for each point. */
export interface PointChannel {
  readonly name: string;
  readonly values: Float32Array<ArrayBuffer>;
  /** The least and the greatest finite value; null where there is none. */
  readonly range: readonly [number, number] | null;
}

/** The colours of points: red, green, blue of each, from 0 to 255. */
export interface PointColours {
  readonly name: string;
  readonly rgb: Uint8Array<ArrayBuffer>;
}

export interface PointSet {
  /** x, y, z of each point in metres, relative to `origin`. */
  readonly positions: Float32Array<ArrayBuffer>;
  readonly origin: Vector;
  /** The bounds of the drawn points, relative to the frame; null where there are none. */
  readonly bounds: readonly [least: Vector, greatest: Vector] | null;
  readonly channels: readonly PointChannel[];
  readonly colours: PointColours | null;
  /** Points of the message, and how many of them have no finite position. Where they are too many, only some are read. */
  readonly totalPoints: number;
  readonly invalidPoints: number;
  /** Points that the message declares, but does not contain. */
  readonly missingPoints: number;
}

/** Coordinates further away than this are stored relative to the first point: float32 resolves 1 mm up to there. */
const FAR_M = 8_192;

/** Return every how many points one is read. */
export function strideOf(totalPoints: number): number {
  return Math.max(1, Math.ceil(totalPoints / MAX_POINTS));
}

/** Points as columns of equal length, in metres. */
export interface PointColumns {
  readonly x: Float64Array;
  readonly y: Float64Array;
  readonly z: Float64Array;
  readonly channels: readonly { readonly name: string; readonly values: Float32Array<ArrayBuffer> }[];
  /** Colours as 0xRRGGBB; null where the points have none. */
  readonly colours: { readonly name: string; readonly packed: Uint32Array } | null;
}

/** Return the points that have a finite position. `totalPoints`: of the message. */
export function pointSetOf(columns: PointColumns, totalPoints: number, missingPoints = 0): PointSet {
  const places = finitePlaces(columns);
  const { positions, origin, bounds } = positionsOf(columns, places);
  const isWhole = places.length === columns.x.length;
  const channels = columns.channels.map(({ name, values }): PointChannel => {
    const visible = isWhole ? values : selected(values, places);
    return { name, values: visible, range: rangeOf(visible) };
  });
  const colours = columns.colours === null ? null : { name: columns.colours.name, rgb: unpacked(columns.colours.packed, places) };
  return { positions, origin, bounds, channels, colours, totalPoints, invalidPoints: columns.x.length - places.length, missingPoints };
}

/** Return the numbers of the points with a finite position. */
function finitePlaces({ x, y, z }: PointColumns): Uint32Array {
  const places = new Uint32Array(x.length);
  let count = 0;
  for (let place = 0; place < x.length; place += 1) {
    if (!Number.isFinite((x[place] as number) + (y[place] as number) + (z[place] as number))) continue;
    places[count] = place;
    count += 1;
  }
  return places.subarray(0, count);
}

function positionsOf({ x, y, z }: PointColumns, places: Uint32Array): Pick<PointSet, "positions" | "origin" | "bounds"> {
  const positions = new Float32Array(3 * places.length);
  const first = places[0] ?? 0;
  const start = [x[first] ?? 0, y[first] ?? 0, z[first] ?? 0] as const;
  const origin: Vector = places.length > 0 && Math.max(...start.map(Math.abs)) > FAR_M ? start : [0, 0, 0];
  const bounds = [x, y, z].map((column, axis) => {
    const offset = origin[axis] as number;
    let [least, greatest] = [Infinity, -Infinity];
    for (let number = 0; number < places.length; number += 1) {
      const value = column[places[number] as number] as number;
      positions[3 * number + axis] = value - offset;
      if (value < least) least = value;
      if (value > greatest) greatest = value;
    }
    return [least, greatest] as const;
  });
  const [bx, by, bz] = bounds as [readonly [number, number], readonly [number, number], readonly [number, number]];
  return { positions, origin, bounds: places.length === 0 ? null : [[bx[0], by[0], bz[0]], [bx[1], by[1], bz[1]]] };
}

function selected(values: Float32Array, places: Uint32Array): Float32Array<ArrayBuffer> {
  const visible = new Float32Array(places.length);
  for (let number = 0; number < places.length; number += 1) visible[number] = values[places[number] as number] as number;
  return visible;
}

function unpacked(packed: Uint32Array, places: Uint32Array): Uint8Array<ArrayBuffer> {
  const rgb = new Uint8Array(3 * places.length);
  for (let number = 0; number < places.length; number += 1) {
    const colour = packed[places[number] as number] as number;
    rgb[3 * number] = colour >> 16;
    rgb[3 * number + 1] = colour >> 8;
    rgb[3 * number + 2] = colour;
  }
  return rgb;
}

/** Return the least and the greatest finite value; null where there is none. */
export function rangeOf(values: Float32Array): readonly [number, number] | null {
  let least = Infinity;
  let greatest = -Infinity;
  for (const value of values) {
    if (!Number.isFinite(value)) continue;
    if (value < least) least = value;
    if (value > greatest) greatest = value;
  }
  return greatest >= least ? [least, greatest] : null;
}

/** Return the buffers of points, to be moved to the page. */
export function buffersOf({ positions, channels, colours }: PointSet): ArrayBuffer[] {
  return [positions.buffer, ...channels.map(({ values }) => values.buffer), ...(colours === null ? [] : [colours.rgb.buffer])];
}
