/** Decompression of chunks to exactly the size that the chunk declares. */

import { ZSTDDecoder } from "zstddec";
import { ReadFailure } from "../failures";
import { MAX_UNPACKED } from "../limits";
import { unpackBzip2 } from "./bzip2";

type Unpack = (packed: Uint8Array, size: number) => Uint8Array;

const UNPACK: Readonly<Record<string, Unpack>> = { lz4: unpackLz4, bz2: unpackBzip2, zstd: unpackZstd };

const zstd = new ZSTDDecoder();

/** Load libzstd, compiled to WebAssembly. `unpack` needs it. */
export function prepareUnpacking(): Promise<void> {
  return zstd.init();
}

const ZSTD_MAGIC = [0x28, 0xb5, 0x2f, 0xfd];

export function isZstd(bytes: Uint8Array): boolean {
  return ZSTD_MAGIC.every((byte, at) => bytes[at] === byte);
}

/** Return the `size` bytes of a chunk; "" and "none" mean that it is not compressed. */
export function unpack(compression: string, packed: Uint8Array, size: number): Uint8Array {
  if (size > MAX_UNPACKED) throw new ReadFailure("too_large", String(size));
  const unpacker = compression === "" || compression === "none" ? asItIs : UNPACK[compression];
  if (unpacker === undefined) throw new ReadFailure("compression_unknown", compression.slice(0, 40));
  try {
    return unpacker(packed, size);
  } catch (thrown) {
    throw new ReadFailure("chunk_damaged", thrown instanceof Error ? thrown.message : "");
  }
}

function asItIs(packed: Uint8Array, size: number): Uint8Array {
  if (packed.length !== size) throw new RangeError(`${packed.length} bytes instead of ${size}`);
  return packed;
}

/** A size in the frame header must match; without one (streamed), the checksum of the chunk detects errors. */
function unpackZstd(packed: Uint8Array, size: number): Uint8Array {
  const declared = zstdContentSize(packed);
  if (declared !== null && declared !== size) throw new RangeError(`${declared} bytes instead of ${size}`);
  const unpacked = zstd.decode(packed, Math.max(1, size)); // it takes 0 for not known
  if (unpacked.length !== size) throw new RangeError(`${unpacked.length} bytes instead of ${size}`); // none where it is damaged or holds more
  return unpacked;
}

/** The memory that decompressing a frame needs, from its header. Source: RFC 8878, 3.1.1.1.2. */
export function zstdWindowBytes(packed: Uint8Array): number {
  if (packed.length < 14) return 0; // too short to hold anything large
  const [descriptor = 0, window = 0] = packed.subarray(4, 6);
  if ((descriptor & 0x20) !== 0) return zstdContentSize(packed) ?? 0;
  const base = 2 ** (10 + (window >> 3));
  return base + (base / 8) * (window & 7);
}

/** Source: RFC 8878, 3.1.1.1 (frame header). */
export function zstdContentSize(packed: Uint8Array): number | null {
  const view = new DataView(packed.buffer, packed.byteOffset, packed.byteLength);
  const descriptor = view.getUint8(4);
  const isSingle = (descriptor & 0x20) !== 0;
  const at = 5 + (isSingle ? 0 : 1) + ([0, 1, 2, 4][descriptor & 3] ?? 0);
  const flag = descriptor >> 6;
  if (flag === 0) return isSingle ? view.getUint8(at) : null;
  if (flag === 1) return view.getUint16(at, true) + 256;
  return flag === 2 ? view.getUint32(at, true) : Number(view.getBigUint64(at, true));
}

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
