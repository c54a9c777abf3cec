/** Pictures with one number for each pixel, such as depth, and their colours. */

export interface PictureValues {
  width: number;
  height: number;
  /** Row by row; 0, NaN and infinity mean that nothing was measured. */
  values: Float32Array<ArrayBuffer>;
  unit: "m" | "mm" | null;
  /** The 1st and the 99th percentile of what was measured; null where nothing was. */
  range: Range | null;
}

/** The values that get the first and the last colour. */
export type Range = readonly [least: number, greatest: number];

const MAX_SORTED = 65_536;
const LEAST_SHARE = 0.01;
const GREATEST_SHARE = 0.99;
const LAST_COLOUR = 255;

export function isMeasured(value: number): boolean {
  return value !== 0 && Number.isFinite(value);
}

export function pictureValues(width: number, height: number, values: Float32Array<ArrayBuffer>, unit: PictureValues["unit"]): PictureValues {
  return { width, height, values, unit, range: rangeOf(values) };
}

/** Return percentiles, so that single wrong measurements do not take all colours. Of large pictures, by every n-th pixel. */
function rangeOf(values: Float32Array): Range | null {
  const every = Math.ceil(values.length / MAX_SORTED);
  const sample = new Float32Array(Math.ceil(values.length / every));
  let count = 0;
  for (let at = 0; at < values.length; at += every) {
    const value = values[at] ?? 0;
    if (isMeasured(value)) sample[count++] = value;
  }
  const sorted = sample.subarray(0, count).sort();
  const least = sorted[Math.floor((count - 1) * LEAST_SHARE)];
  const greatest = sorted[Math.ceil((count - 1) * GREATEST_SHARE)];
  return least === undefined || greatest === undefined ? null : [least, greatest];
}

/** Return the values as RGBA by a table of 256 colours. What was not measured is transparent. */
export function coloured({ values }: Pick<PictureValues, "values">, [least, greatest]: Range, table: Uint8Array): Uint8ClampedArray<ArrayBuffer> {
  const rgba = new Uint8ClampedArray(values.length * 4);
  const pixels = new Uint32Array(rgba.buffer);
  const colours = new Uint32Array(table.slice().buffer);
  const scale = greatest > least ? LAST_COLOUR / (greatest - least) : Infinity;
  for (let at = 0; at < values.length; at++) {
    const value = values[at] ?? 0;
    if (!isMeasured(value)) continue;
    const place = value <= least ? 0 : value >= greatest ? LAST_COLOUR : Math.round((value - least) * scale);
    pixels[at] = colours[place] ?? 0;
  }
  return rgba;
}

/** Return 256 greys from black to white, as `coloured` takes them. */
export function greys(): Uint8Array {
  return Uint8Array.from({ length: 4 * (LAST_COLOUR + 1) }, (_, at) => (at % 4 === 3 ? LAST_COLOUR : at >> 2));
}
