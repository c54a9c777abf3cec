/** Opening a recording by what the server found that it is. */

import { MOST_UNASKED } from "../limits";
import type { ReadableFormat } from "../protocol";
import type { Ranges } from "../ranges";
import { openBag } from "./bag";
import { openMcap } from "./mcap";
import type { Recording } from "./recording";

const OPEN: Readonly<Record<ReadableFormat, (source: Ranges, mostBytes: number) => Promise<Recording>>> = { mcap: openMcap, rosbag1: openBag };

/** Open by the index; where there is none, by what up to `mostBytes` of the beginning tell.
 *
 * @throws ReadFailure where neither works.
 */
export function openRecording(format: ReadableFormat, source: Ranges, mostBytes = MOST_UNASKED): Promise<Recording> {
  return OPEN[format](source, mostBytes);
}
