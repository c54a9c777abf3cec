/** Messages of chunks in order of log time, though chunks overlap in time and some of them are damaged. */

import { ReadFailure } from "../failures";
import type { FailureCode } from "../failures";
import { MOST_HELD } from "../limits";
import type { Message, OnDamage, Order, Span } from "./recording";

/** What one chunk holds of a topic. `heldBytes` stay in memory while one of its messages does. */
export interface ChunkContent {
  messages: Message[];
  heldBytes: number;
}

/** Where a chunk begins in the file, and the time that its index gives it. */
interface Placed extends Span {
  at: number;
}

/** Failures of one chunk: the others may be whole. */
const DAMAGE: ReadonlySet<FailureCode> = new Set<FailureCode>(["chunk_damaged", "index_damaged"]);

/** Return the messages within the span, chunk by chunk. A damaged chunk is told to `onDamage` and left out.
 *
 * @throws ReadFailure too_large, where too much overlaps in time; what `read` throws, unless it is damage.
 */
export async function* inOrder<Chunk extends Placed>(
  chunks: readonly Chunk[],
  read: (chunk: Chunk) => Promise<ChunkContent>,
  { span, order, onDamage }: { span: Span; order: Order; onDamage: OnDamage },
): AsyncIterable<Message> {
  const isForward = order === "forward";
  const sorted = chunks.toSorted(isForward ? byStart : byEnd);
  let waiting: { message: Message; heldBytes: number }[] = [];
  for (const [number, chunk] of sorted.entries()) {
    const { messages, heldBytes } = await readOrReport(chunk, read, onDamage);
    const within = messages.filter(({ logTimeNs }) => logTimeNs >= span.fromNs && logTimeNs <= span.toNs);
    if (!isForward) within.reverse();
    waiting = waiting.concat(within.map((message, place) => ({ message, heldBytes: place === 0 ? heldBytes : 0 })));
    if (waiting.reduce((sum, each) => sum + each.heldBytes, 0) > MOST_HELD) throw new ReadFailure("too_large");
    waiting.sort(({ message: a }, { message: b }) => byTime(a, b, isForward));
    const next = sorted[number + 1];
    // Messages that none of the next chunk can come before are ready.
    const ready = waiting.findIndex(({ message: { logTimeNs } }) =>
      next === undefined ? false : isForward ? logTimeNs > next.fromNs : logTimeNs < next.toNs,
    );
    const count = ready < 0 ? waiting.length : ready;
    for (const { message } of waiting.slice(0, count)) yield message;
    waiting = waiting.slice(count);
  }
}

async function readOrReport<Chunk extends Placed>(
  chunk: Chunk,
  read: (chunk: Chunk) => Promise<ChunkContent>,
  onDamage: OnDamage,
): Promise<ChunkContent> {
  try {
    return await read(chunk);
  } catch (thrown) {
    const failure = thrown instanceof RangeError ? new ReadFailure("chunk_damaged", thrown.message) : thrown;
    if (!(failure instanceof ReadFailure) || !DAMAGE.has(failure.code)) throw thrown;
    onDamage({ fromNs: chunk.fromNs, toNs: chunk.toNs, failure });
    return { messages: [], heldBytes: 0 };
  }
}

function byStart(a: Placed, b: Placed): number {
  return a.fromNs < b.fromNs ? -1 : a.fromNs > b.fromNs ? 1 : a.at - b.at;
}

function byEnd(a: Placed, b: Placed): number {
  return a.toNs > b.toNs ? -1 : a.toNs < b.toNs ? 1 : b.at - a.at;
}

function byTime(a: Message, b: Message, isForward: boolean): number {
  if (a.logTimeNs === b.logTimeNs) return 0;
  return a.logTimeNs < b.logTimeNs === isForward ? -1 : 1;
}
