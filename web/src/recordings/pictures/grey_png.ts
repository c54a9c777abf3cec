/** PNG with 16-bit greys, of which a browser would keep 8 bits.
 *
 * Source: Portable Network Graphics (W3C), 9 (filters), 11.2 (critical chunks).
 */

import { ReadFailure } from "../failures";
import { MAX_GREY_PIXELS } from "../limits";
import { checkSize } from "./pixels";

const FIRST_CHUNK = 8;
const [DEPTH_AT, COLOUR_TYPE_AT, INTERLACE_AT] = [24, 25, 28];
const DATA_CHUNK = "IDAT";
const BYTES = 2;

/** Whether a PNG has one number of 16 bits for each pixel. */
export function isGreyPng(png: Uint8Array): boolean {
  return png[DEPTH_AT] === 16 && png[COLOUR_TYPE_AT] === 0;
}

/** Return the pixels, row by row, of a PNG with a whole header. @throws ReadFailure picture_unreadable, picture_too_large. */
export async function greyPixels(png: Uint8Array): Promise<{ width: number; height: number; pixels: Uint16Array }> {
  if (png[INTERLACE_AT] !== 0) throw new ReadFailure("picture_unreadable", "interlaced");
  const view = new DataView(png.buffer, png.byteOffset, png.byteLength);
  const [width, height] = [view.getUint32(16), view.getUint32(20)];
  const row = width * BYTES;
  checkSize(width, height, MAX_GREY_PIXELS);
  const lines = await inflated(dataChunks(png, view), height * (1 + row));
  const pixels = new Uint16Array(width * height);
  let above = new Uint8Array(row);
  for (let y = 0; y < height; y++) {
    const start = y * (1 + row);
    const line = lines.subarray(start + 1, start + 1 + row);
    unfilter(lines[start] ?? 0, line, above);
    for (let x = 0; x < width; x++) pixels[y * width + x] = ((line[2 * x] ?? 0) << 8) | (line[2 * x + 1] ?? 0);
    above = line;
  }
  return { width, height, pixels };
}

function dataChunks(png: Uint8Array, view: DataView): Uint8Array<ArrayBuffer>[] {
  const chunks: Uint8Array<ArrayBuffer>[] = [];
  for (let at = FIRST_CHUNK; at + 8 <= png.length; ) {
    const length = view.getUint32(at);
    const name = String.fromCharCode(...png.subarray(at + 4, at + 8));
    if (name === DATA_CHUNK) chunks.push(png.slice(at + 8, at + 8 + length));
    at += 12 + length;
  }
  return chunks;
}

/** Return exactly as many bytes as the picture has. */
async function inflated(chunks: readonly Uint8Array<ArrayBuffer>[], size: number): Promise<Uint8Array<ArrayBuffer>> {
  const whole = new Uint8Array(size);
  let at = 0;
  try {
    const reader = new Blob([...chunks]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
    for (let piece = await reader.read(); !piece.done; piece = await reader.read()) {
      if (at + piece.value.length > size) {
        await reader.cancel();
        throw new ReadFailure("picture_unreadable", "it has more pixels than its size");
      }
      whole.set(piece.value, at);
      at += piece.value.length;
    }
  } catch (thrown) {
    throw thrown instanceof ReadFailure ? thrown : new ReadFailure("picture_unreadable", "image/png");
  }
  if (at < size) throw new ReadFailure("picture_unreadable", "it is cut off");
  return whole;
}

/** Undo the filter of a row, in place. */
function unfilter(filter: number, line: Uint8Array, above: Uint8Array): void {
  if (filter > 4) throw new ReadFailure("picture_unreadable", `filter ${filter}`);
  if (filter === 0) return;
  for (let at = 0; at < line.length; at++) {
    const left = at < BYTES ? 0 : (line[at - BYTES] ?? 0);
    const up = above[at] ?? 0;
    const upLeft = at < BYTES ? 0 : (above[at - BYTES] ?? 0);
    const predicted = filter === 1 ? left : filter === 2 ? up : filter === 3 ? (left + up) >> 1 : paeth(left, up, upLeft);
    line[at] = (line[at] ?? 0) + predicted;
  }
}

function paeth(left: number, up: number, upLeft: number): number {
  const estimate = left + up - upLeft;
  const [toLeft, toUp, toUpLeft] = [Math.abs(estimate - left), Math.abs(estimate - up), Math.abs(estimate - upLeft)];
  if (toLeft <= toUp && toLeft <= toUpLeft) return left;
  return toUp <= toUpLeft ? up : upLeft;
}
