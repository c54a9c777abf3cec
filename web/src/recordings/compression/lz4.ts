/** LZ4 frames, strictly within bounds: what a bag or an MCAP calls "lz4".
 *
 * Source: LZ4 frame format 1.6.1 and LZ4 block format (lz4/doc). Checksums are skipped: MCAP carries its own.
 */

const MAGIC = 0x184d2204;
const SKIPPABLE = 0x184d2a50;
const UNCOMPRESSED = 0x80000000;

/** Return what `packed` holds: exactly `size` bytes.
 *
 * @throws RangeError where the frame is not LZ4, holds more or less than that, or refers to what is not there.
 */
export function unpackLz4(packed: Uint8Array, size: number): Uint8Array {
  const target = new Uint8Array(size);
  const view = new DataView(packed.buffer, packed.byteOffset, packed.byteLength);
  let at = 0;
  let filled = 0;
  while (at < packed.length) {
    const magic = view.getUint32(at, true);
    if (magic >>> 4 === SKIPPABLE >>> 4) {
      at += 8 + view.getUint32(at + 4, true);
      continue;
    }
    if (magic !== MAGIC) throw new RangeError(`no LZ4 frame at ${at}`);
    [at, filled] = frame(packed, view, at + 4, target, filled);
  }
  if (filled !== size) throw new RangeError(`${filled} bytes instead of ${size}`);
  return target;
}

function frame(
  packed: Uint8Array,
  view: DataView,
  start: number,
  target: Uint8Array,
  filledBefore: number,
): [number, number] {
  const flags = view.getUint8(start);
  if (flags >> 6 !== 1) throw new RangeError("an unknown version of LZ4 frames");
  if (flags & 1) throw new RangeError("LZ4 with a dictionary");
  const blockChecksum = flags & 0x10 ? 4 : 0;
  let at = start + 2 + (flags & 8 ? 8 : 0) + 1;
  let filled = filledBefore;
  for (;;) {
    const word = view.getUint32(at, true);
    at += 4;
    if (word === 0) break;
    const length = word % UNCOMPRESSED;
    if (at + length > packed.length) throw new RangeError("an LZ4 block is cut off");
    const body = packed.subarray(at, at + length);
    filled = word >= UNCOMPRESSED ? copied(body, target, filled) : block(body, target, filled);
    at += length + blockChecksum;
  }
  return [at + (flags & 4 ? 4 : 0), filled];
}

function copied(source: Uint8Array, target: Uint8Array, filled: number): number {
  target.set(source, filled); // throws a RangeError where it does not fit
  return filled + source.length;
}

function block(source: Uint8Array, target: Uint8Array, filledBefore: number): number {
  let at = 0;
  let filled = filledBefore;
  while (at < source.length) {
    const token = source[at++] ?? 0;
    let literals = token >> 4;
    if (literals === 15) [literals, at] = longer(source, at, literals);
    if (at + literals > source.length) throw new RangeError("LZ4 literals are cut off");
    filled = copied(source.subarray(at, at + literals), target, filled);
    at += literals;
    if (at === source.length) break; // the last sequence has no match
    if (at + 2 > source.length) throw new RangeError("an LZ4 match is cut off");
    const distance = (source[at] ?? 0) | ((source[at + 1] ?? 0) << 8);
    at += 2;
    let match = token & 15;
    if (match === 15) [match, at] = longer(source, at, match);
    filled = repeated(target, filled, distance, match + 4);
  }
  return filled;
}

function longer(source: Uint8Array, start: number, length: number): [number, number] {
  let at = start;
  let total = length;
  for (;;) {
    const more = source[at++];
    if (more === undefined) throw new RangeError("an LZ4 length is cut off");
    total += more;
    if (more !== 255) return [total, at];
  }
}

function repeated(target: Uint8Array, filled: number, distance: number, length: number): number {
  const end = filled + length;
  if (distance === 0 || distance > filled || end > target.length) throw new RangeError("an LZ4 match out of bounds");
  if (distance >= length) target.copyWithin(filled, filled - distance, filled - distance + length);
  else for (let at = filled; at < end; at++) target[at] = target[at - distance] ?? 0;
  return end;
}
