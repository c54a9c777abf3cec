/** Decompression of chunks, into exactly as many bytes as the chunk says that it holds. */

import { decompress } from "fzstd";
import { ReadFailure } from "../failures";
import { MOST_UNPACKED } from "../limits";
import { unpackBzip2 } from "./bzip2";
import { unpackLz4 } from "./lz4";

type Unpack = (packed: Uint8Array, size: number) => Uint8Array;

const UNPACK: Readonly<Record<string, Unpack>> = { lz4: unpackLz4, bz2: unpackBzip2, zstd: unpackZstd };

const ZSTD_MAGIC = [0x28, 0xb5, 0x2f, 0xfd];

export function isZstd(bytes: Uint8Array): boolean {
  return ZSTD_MAGIC.every((byte, at) => bytes[at] === byte);
}

/** Return the `size` bytes of a chunk; "" and "none" mean that it is not compressed. */
export function unpack(compression: string, packed: Uint8Array, size: number): Uint8Array {
  if (size > MOST_UNPACKED) throw new ReadFailure("too_large", String(size));
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

/** The frame's own word on its size must agree; where it gives none (streamed), the chunk's checksum tells. */
function unpackZstd(packed: Uint8Array, size: number): Uint8Array {
  const said = zstdContentSize(packed);
  if (said !== null && said !== size) throw new RangeError(`${said} bytes instead of ${size}`);
  return decompress(packed, new Uint8Array(size)); // a RangeError where it holds more
}

/** The memory that decompressing a frame takes, as its header says. Source: RFC 8878, 3.1.1.1.2. */
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
