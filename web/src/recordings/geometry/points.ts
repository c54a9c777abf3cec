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

/** Collects points and their values, without those that have no finite position. */
export class PointCollector {
  private readonly positions: Float32Array<ArrayBuffer>;
  private readonly values: readonly Float32Array<ArrayBuffer>[];
  private readonly rgb: Uint8Array<ArrayBuffer> | null;
  private readonly least: [number, number, number] = [Infinity, Infinity, Infinity];
  private readonly greatest: [number, number, number] = [-Infinity, -Infinity, -Infinity];
  private origin: Vector = [0, 0, 0];
  private count = 0;
  private invalid = 0;

  /** `capacity`: the points that come at most. */
  constructor(capacity: number, private readonly names: readonly string[], private readonly colourName: string | null = null) {
    this.positions = new Float32Array(3 * capacity);
    this.values = names.map(() => new Float32Array(capacity));
    this.rgb = colourName === null ? null : new Uint8Array(3 * capacity);
  }

  /** Add a point; returns its place, or null where it has no finite position. */
  add(x: number, y: number, z: number): number | null {
    if (!Number.isFinite(x + y + z)) {
      this.invalid += 1;
      return null;
    }
    if (this.count === 0 && Math.max(Math.abs(x), Math.abs(y), Math.abs(z)) > FAR_M) this.origin = [x, y, z];
    const place = this.count;
    this.count += 1;
    this.positions[3 * place] = x - this.origin[0];
    this.positions[3 * place + 1] = y - this.origin[1];
    this.positions[3 * place + 2] = z - this.origin[2];
    this.extend(0, x);
    this.extend(1, y);
    this.extend(2, z);
    return place;
  }

  setValue(place: number, channel: number, value: number): void {
    const values = this.values[channel];
    if (values !== undefined) values[place] = value;
  }

  setColour(place: number, red: number, green: number, blue: number): void {
    this.rgb?.set([red, green, blue], 3 * place);
  }

  points(totalPoints: number, missingPoints = 0): PointSet {
    const channels = this.names.map((name, number): PointChannel => {
      const values = (this.values[number] as Float32Array<ArrayBuffer>).slice(0, this.count);
      return { name, values, range: rangeOf(values) };
    });
    return {
      positions: this.positions.slice(0, 3 * this.count),
      origin: this.origin,
      bounds: this.count === 0 ? null : [[...this.least], [...this.greatest]],
      channels,
      colours: this.colourName === null || this.rgb === null ? null : { name: this.colourName, rgb: this.rgb.slice(0, 3 * this.count) },
      totalPoints,
      invalidPoints: this.invalid,
      missingPoints,
    };
  }

  private extend(axis: 0 | 1 | 2, value: number): void {
    if (value < this.least[axis]) this.least[axis] = value;
    if (value > this.greatest[axis]) this.greatest[axis] = value;
  }
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
