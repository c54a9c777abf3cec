/** Opens a recording by the format that the server detected. Files compressed as a whole are decompressed into memory. */

import { isZstd, prepareUnpacking, zstdWindowBytes } from "../compression/unpack";
import { MAX_BYTES_UNCONFIRMED, MAX_CHUNK_CACHE, MAX_WHOLE_PACKED, MAX_WHOLE_UNPACKED, READ_AHEAD } from "../limits";
import type { ReadableFormat } from "../protocol";
import type { Source } from "../ranges";
import { openBag } from "./bag";
import { ChunkCache } from "./chunk_cache";
import { openDb3 } from "./db3";
import { openMcap } from "./mcap";
import { openUlog } from "./ulog";
import { joined, type Recording } from "./recording";
import { Decompress } from "fzstd";
import { failureOf, ReadFailure } from "../failures";

const OPEN: Readonly<Record<ReadableFormat, (source: Source, maxBytes: number, cache: ChunkCache) => Promise<Recording>>> = { mcap: openMcap, rosbag1: openBag, db3: openDb3, ulog: openUlog };

/** Open by the index; without one, by scanning up to `maxBytes` of the beginning. `cacheBytes` of decompressed chunks stay in memory.
 *
 * A file that is compressed as a whole is decompressed first.
 *
 * @throws ReadFailure where neither works.
 */
export async function openRecording(format: ReadableFormat, source: Source, { maxBytes = MAX_BYTES_UNCONFIRMED, cacheBytes = MAX_CHUNK_CACHE } = {}): Promise<Recording> {
  const [head] = await Promise.all([source.read(0, Math.min(4, source.sizeBytes)), prepareUnpacking()]);
  return OPEN[format](isZstd(head) ? await decompressed(source) : source, maxBytes, new ChunkCache(cacheBytes));
}

/** Read and decompress a whole file.
 *
 * @throws ReadFailure compressed_whole, where it is too large for that; chunk_damaged.
 */
export async function decompressed(source: Source): Promise<Source> {
  if (source.sizeBytes > MAX_WHOLE_PACKED) throw new ReadFailure("compressed_whole", String(source.sizeBytes));
  const parts: Uint8Array[] = [];
  let size = 0;
  const stream = new Decompress((part) => {
    size += part.length;
    if (size > MAX_WHOLE_UNPACKED) throw new ReadFailure("compressed_whole", String(source.sizeBytes));
    parts.push(part.slice());
  });
  source.ahead = READ_AHEAD;
  try {
    for (let at = 0; at < source.sizeBytes; at += READ_AHEAD) {
      const end = Math.min(at + READ_AHEAD, source.sizeBytes);
      const packed = await source.read(at, end - at);
      if (at === 0 && zstdWindowBytes(packed) > MAX_WHOLE_UNPACKED) {
        throw new ReadFailure("compressed_whole", String(source.sizeBytes));
      }
      stream.push(packed, end === source.sizeBytes);
    }
  } catch (thrown) {
    // What was decompressed of a file that breaks off can still be looked into.
    const failure = failureOf(thrown, "chunk_damaged");
    if (failure.code !== "chunk_damaged" || size === 0) throw failure;
  } finally {
    source.ahead = 0;
  }
  return inMemory(joined(parts));
}

function inMemory(bytes: Uint8Array): Source {
  return {
    sizeBytes: bytes.length,
    ahead: 0,
    bytesRead: 0,
    read: (offset, length) => {
      if (offset >= 0 && length >= 0 && offset + length <= bytes.length) return Promise.resolve(bytes.subarray(offset, offset + length));
      return Promise.reject(new ReadFailure("index_damaged", `${length} bytes at ${offset} of ${bytes.length}`));
    },
  };
}
