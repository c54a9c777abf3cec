/** Opening a recording by what the server found that it is. */

import type { ReadableFormat } from "../protocol";
import type { Ranges } from "../ranges";
import { openBag } from "./bag";
import { openMcap } from "./mcap";
import type { Recording } from "./recording";

const OPEN: Readonly<Record<ReadableFormat, (source: Ranges) => Promise<Recording>>> = { mcap: openMcap, rosbag1: openBag };

/** @throws ReadFailure where it cannot be read by its index. */
export function openRecording(format: ReadableFormat, source: Ranges): Promise<Recording> {
  return OPEN[format](source);
}
