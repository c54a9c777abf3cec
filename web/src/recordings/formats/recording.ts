/** The interface of all formats: topics, and the messages of a topic in a time range, ordered by log time. */

import { ReadFailure, type FailureCode } from "../failures";
import type { Source } from "../ranges";
import { MAX_OVERLAPPING } from "../limits";

/** The encoding of a channel's messages, and their definition. */
export interface Schema {
  name: string;
  /** "ros1msg", "ros2msg", "ros2idl", "jsonschema", "protobuf", "" … */
  encoding: string;
  /** "ros1", "cdr", "json", "protobuf" … */
  messageEncoding: string;
  definition: Uint8Array;
}

/** Names and values, in the order of the file. */
export type Properties = readonly (readonly [string, string])[];

/** A topic as one publisher wrote it. */
export interface Channel {
  topic: string;
  schema: Schema;
  properties: Properties;
}

export interface RecordedTopic {
  name: string;
  schema: Schema;
}

/** Inclusive at both ends; integer nanoseconds of the log clock. */
export interface Span {
  fromNs: bigint;
  toNs: bigint;
}

export interface Message {
  logTimeNs: bigint;
  /** The log time where the format has no other; so is `sequence` 0. */
  publishTimeNs: bigint;
  sequence: number;
  channel: Channel;
  data: Uint8Array;
  /** The times that the index gives its chunk. */
  chunkSpan: Span;
}

/** An attachment or metadata record of an MCAP. `length`: with its head. `indexFields`: what its index repeats. */
export interface OtherRecord {
  op: number;
  at: number;
  length: number;
  indexFields: Uint8Array;
}

/** A part of a recording that could not be read, by the time that its index gives it. */
export interface Damage extends Span {
  failure: ReadFailure;
}

export type OnDamage = (damage: Damage) => void;

export type Order = "forward" | "backward";

/** A piece of the file that must be read as a whole. */
export interface Piece extends Span {
  /** Where it begins in the file. */
  at: number;
  bytes: number;
  /** Null where the index does not say. */
  topics: ReadonlySet<string> | null;
}

export interface Recording {
  readonly source: Source;
  /** Null where the recording holds no message. */
  readonly span: Span | null;
  /** Where a recording without index was read up to, to make one: the rest is not seen. Null for one with an index. */
  readonly indexedUntil: number | null;
  readonly topics: readonly RecordedTopic[];
  /** In the order of the index. */
  readonly channels: readonly Channel[];
  /** Of an MCAP, such as "ros2". */
  readonly profile: string;
  /** Whether the times of the index cannot be true. */
  readonly isIndexContradictory: boolean;
  /** The pieces that may hold messages of the topics within the span, in order of time. */
  pieces(topics: readonly string[], span: Span): Piece[];
  /** The messages of the topics within the span, by log time; of equal times, in the order of the chunks and in them.
   *
   * Damaged parts are reported to `onDamage` and skipped.
   */
  messages(topics: readonly string[], span: Span, order: Order, onDamage: OnDamage): AsyncIterable<Message>;
  /** The messages of the topics in one piece, in its order. @throws ReadFailure, where it is damaged. */
  readPiece(piece: Piece, topics: readonly string[]): Promise<readonly Message[]>;
  /** The attachments and metadata records, in the order of the file. @throws ReadFailure chunk_damaged. */
  otherRecords(): AsyncIterable<OtherRecord>;
}

/** The bytes that pieces have together. */
export function cost(pieces: readonly Piece[]): number {
  return pieces.reduce((sum, piece) => sum + piece.bytes, 0);
}

/** The maximum of bytes in memory at once where pieces overlap in time; `size` returns the unpacked size of a piece. */
export function mostOverlappingBytes<P extends Span>(pieces: readonly P[], size: (piece: P) => number): number {
  const edges = pieces.flatMap((piece) => [
    { at: piece.fromNs, change: size(piece) },
    { at: piece.toNs, change: -size(piece) },
  ]);
  // Chunks that end at the time at which another begins do not overlap.
  edges.sort((a, b) => (a.at === b.at ? a.change - b.change : a.at < b.at ? -1 : 1));
  let current = 0;
  let most = 0;
  for (const edge of edges) {
    current += edge.change;
    most = Math.max(most, current);
  }
  return Math.max(most, ...pieces.slice(0, 1).map(size));
}

export function joined(parts: readonly Uint8Array[]): Uint8Array {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}

/** What one chunk holds of a topic. `heldBytes` stay in memory while one of its messages does. */
export interface ChunkContent {
  messages: Message[];
  retainedBytes: number;
}

/** Where a chunk begins in the file, and the time that its index gives it. */
interface Placed extends Span {
  at: number;
}

/** Failures of one chunk: the others may be whole. */
const DAMAGE: ReadonlySet<FailureCode> = new Set<FailureCode>(["chunk_damaged", "index_damaged"]);

/** Return the messages within the span, chunk by chunk. A damaged chunk is reported to `onDamage` and skipped.
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
  let waiting: { message: Message; retainedBytes: number }[] = [];
  for (const [number, chunk] of sorted.entries()) {
    const { messages, retainedBytes } = await readOrReport(chunk, read, onDamage);
    const within = messages.filter(({ logTimeNs }) => logTimeNs >= span.fromNs && logTimeNs <= span.toNs);
    if (!isForward) within.reverse();
    waiting = waiting.concat(within.map((message, place) => ({ message, retainedBytes: place === 0 ? retainedBytes : 0 })));
    if (waiting.reduce((sum, item) => sum + item.retainedBytes, 0) > MAX_OVERLAPPING) throw new ReadFailure("too_large");
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
    return { messages: [], retainedBytes: 0 };
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
