/** Opening a recording by what the server found that it is. */

import { isZstd } from "../compression/unpack";
import { MOST_UNASKED } from "../limits";
import type { ReadableFormat } from "../protocol";
import type { Source } from "../ranges";
import { openBag } from "./bag";
import { openMcap } from "./mcap";
import type { Recording } from "./recording";
import { decompressed } from "./whole_file";

const OPEN: Readonly<Record<ReadableFormat, (source: Source, mostBytes: number) => Promise<Recording>>> = { mcap: openMcap, rosbag1: openBag };

/** Open by the index; where there is none, by what up to `mostBytes` of the beginning tell.
 *
 * A file that is compressed as a whole is decompressed first.
 *
 * @throws ReadFailure where neither works.
 */
export async function openRecording(format: ReadableFormat, source: Source, mostBytes = MOST_UNASKED): Promise<Recording> {
  const head = await source.read(0, Math.min(4, source.sizeBytes));
  return OPEN[format](isZstd(head) ? await decompressed(source) : source, mostBytes);
}
