/** What the formats have in common: topics, and the messages of one topic in a span of time. */

import type { ReadFailure } from "../failures";
import type { Source } from "../ranges";

/** How messages of a channel are written, and the text or bytes that say so. */
export interface Schema {
  name: string;
  /** "ros1msg", "ros2msg", "ros2idl", "jsonschema", "protobuf", "" … */
  encoding: string;
  /** "ros1", "cdr", "json", "protobuf" … */
  messageEncoding: string;
  definition: Uint8Array;
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
  schema: Schema;
  data: Uint8Array;
}

/** A part of a recording that could not be read, by the time that its index gives it. */
export interface Damage extends Span {
  failure: ReadFailure;
}

export type OnDamage = (damage: Damage) => void;

export type Order = "forward" | "backward";

/** A piece of the file that must be read as a whole. */
export interface Piece extends Span {
  bytes: number;
}

export interface Recording {
  readonly source: Source;
  /** Null where the recording holds no message. */
  readonly span: Span | null;
  /** Where a recording without index was read up to, to make one: the rest is not seen. Null for one with an index. */
  readonly mendedUntil: number | null;
  readonly topics: readonly RecordedTopic[];
  /** The pieces that may hold messages of the topic within the span, in order of time. */
  pieces(topic: string, span: Span): Piece[];
  /** The messages of the topic within the span, by log time. Damaged parts are told to `onDamage` and left out. */
  messages(topic: string, span: Span, order: Order, onDamage: OnDamage): AsyncIterable<Message>;
}

/** The bytes that pieces have together. */
export function cost(pieces: readonly Piece[]): number {
  return pieces.reduce((sum, piece) => sum + piece.bytes, 0);
}

/** The most bytes that are held at once where pieces overlap in time; `size` says what a piece has when unpacked. */
export function mostHeld<P extends Span>(pieces: readonly P[], size: (piece: P) => number): number {
  const edges = pieces.flatMap((piece) => [
    { at: piece.fromNs, change: size(piece) },
    { at: piece.toNs, change: -size(piece) },
  ]);
  // At one instant, what ends is let go before what begins is taken: chunks that only touch are read one by one.
  edges.sort((a, b) => (a.at === b.at ? a.change - b.change : a.at < b.at ? -1 : 1));
  let held = 0;
  let most = 0;
  for (const edge of edges) {
    held += edge.change;
    most = Math.max(most, held);
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
