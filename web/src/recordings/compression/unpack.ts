/** Decompression of chunks, into exactly as many bytes as the chunk says that it holds. */

import { decompress } from "fzstd";
import { ReadFailure } from "../failures";
import { MOST_UNPACKED } from "../limits";
import { unpackBzip2 } from "./bzip2";
import { unpackLz4 } from "./lz4";

type Unpack = (packed: Uint8Array, size: number) => Uint8Array;

const UNPACK: Readonly<Record<string, Unpack>> = { lz4: unpackLz4, bz2: unpackBzip2, zstd: unpackZstd };

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

function unpackZstd(packed: Uint8Array, size: number): Uint8Array {
  // A byte more than promised, to see a frame that holds more.
  const bytes = decompress(packed, new Uint8Array(size + 1));
  if (bytes.length !== size) throw new RangeError(`not ${size} bytes`);
  return bytes;
}
