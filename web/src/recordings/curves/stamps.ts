/** The stamps of messages in nanoseconds. Decoded times of ROS are doubles, which are exact to 0.2 µs only. */

import { isZstd } from "../compression/unpack";
import { isFields, type Value } from "../decoding/decoder";
import { wellKnownDefinitions } from "../decoding/well_known";
import type { Message, Schema, Span } from "../formats/recording";
import { numberOf, part } from "../geometry/values";

type ReadStamp = (data: Uint8Array, value: Value) => bigint | null;

const HEADER_FIRST = /^(?:std_msgs\/(?:msg\/)?)?Header[ \t]+header\b/;
/** In ROS 1, a sequence number precedes the stamp; in CDR, four bytes declare the byte order. */
const STAMP_AT = 4;
const STAMP_END = 12;
const NS_PER_S = 1_000_000_000n;
/** A stamp farther outside of the recording is of another clock. */
const FAR_NS = 60n * NS_PER_S;

export class Stamps {
  private readonly readers = new Map<Schema, ReadStamp>();

  constructor(private readonly span: Span) {}

  /** Returns the stamp of a message; null where it has none, or one of another clock. */
  of({ data, channel }: Message, value: Value): bigint | null {
    const read = this.readers.get(channel.schema) ?? stampReader(channel.schema);
    this.readers.set(channel.schema, read);
    const stampNs = read(data, value);
    return stampNs !== null && stampNs >= this.span.fromNs - FAR_NS && stampNs <= this.span.toNs + FAR_NS ? stampNs : null;
  }
}

function stampReader(schema: Schema): ReadStamp {
  const isCdr = schema.messageEncoding === "cdr";
  if ((isCdr || schema.messageEncoding === "ros1") && beginsWithHeader(schema)) return isCdr ? cdrStamp : ros1Stamp;
  return (_, value) => decodedStamp(value);
}

function beginsWithHeader({ name, encoding, definition }: Schema): boolean {
  const text = encoding === "" ? (wellKnownDefinitions(name)[0] ?? "") : new TextDecoder().decode(definition);
  const first = text.split("\n").map((line) => line.trim()).find((line) => line !== "" && !line.startsWith("#"));
  return HEADER_FIRST.test(first ?? "");
}

function ros1Stamp(data: Uint8Array, value: Value): bigint | null {
  return data.length < STAMP_END ? decodedStamp(value) : stampAt(data, true);
}

function cdrStamp(data: Uint8Array, value: Value): bigint | null {
  return data.length < STAMP_END || isZstd(data) ? decodedStamp(value) : stampAt(data, data[1] === 1);
}

function stampAt(data: Uint8Array, isLittle: boolean): bigint | null {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const [seconds, nanoseconds] = [view.getUint32(STAMP_AT, isLittle), view.getUint32(STAMP_AT + 4, isLittle)];
  return orNone(BigInt(seconds) * NS_PER_S + BigInt(nanoseconds));
}

/** Returns the stamp of a decoded message: the parts of JSON and protobuf are exact. */
function decodedStamp(value: Value): bigint | null {
  const stamp = part(value, "header", "stamp") ?? part(value, "timestamp");
  if (typeof stamp === "number") return part(value, "header", "stamp") === null ? null : fromParts(Math.floor(stamp), Math.round((stamp % 1) * 1e9));
  if (!isFields(stamp)) return null;
  const seconds = part(stamp, "sec") ?? part(stamp, "secs") ?? part(stamp, "seconds");
  const nanoseconds = part(stamp, "nsec") ?? part(stamp, "nanosec") ?? part(stamp, "nsecs") ?? part(stamp, "nanos") ?? 0;
  return fromParts(numberOf(seconds), numberOf(nanoseconds));
}

function fromParts(seconds: number, nanoseconds: number): bigint | null {
  if (!Number.isSafeInteger(seconds) || !Number.isSafeInteger(nanoseconds)) return null;
  return orNone(BigInt(seconds) * NS_PER_S + BigInt(nanoseconds));
}

function orNone(stampNs: bigint): bigint | null {
  return stampNs > 0n ? stampNs : null;
}
