/** Records of a ROS 1 bag.
 *
 * Source: wiki.ros.org/Bags/Format/2.0. Everything is little endian; times are unsigned seconds and nanoseconds.
 */

import { ReadFailure } from "../failures";

export const MAGIC = "#ROSBAG V2.0\n";

export const Op = { message: 2, header: 3, index: 4, chunk: 5, chunkInfo: 6, connection: 7 } as const;

export interface BagRecord {
  op: number;
  fields: ReadonlyMap<string, Uint8Array>;
  data: Uint8Array;
  /** Where the next record begins in the same bytes. */
  next: number;
}

const TEXT = new TextDecoder();

/** Return the record at `at` of `bytes`.
 *
 * @throws ReadFailure index_damaged where it is cut off or no record.
 */
export function recordAt(bytes: Uint8Array, at: number): BagRecord {
  const head = sized(bytes, at);
  const body = sized(bytes, at + 4 + head.length);
  const fields = fieldsOf(head);
  return { op: fields.get("op")?.[0] ?? -1, fields, data: body, next: at + 8 + head.length + body.length };
}

/** Return the header of the record at `at`, whose data may lie outside of `bytes`, and where and how long that is. */
export function headAt(bytes: Uint8Array, at: number): { op: number; fields: ReadonlyMap<string, Uint8Array>; dataAt: number; length: number } {
  const head = sized(bytes, at);
  const fields = fieldsOf(head);
  const lengthAt = at + 4 + head.length;
  return { op: fields.get("op")?.[0] ?? -1, fields, dataAt: lengthAt + 4, length: uint32(bytes, lengthAt) };
}

/** Return the fields of a header: `name=value`, each with its length before it. */
export function fieldsOf(head: Uint8Array): Map<string, Uint8Array> {
  const fields = new Map<string, Uint8Array>();
  for (let at = 0; at < head.length; ) {
    const field = sized(head, at);
    const equals = field.indexOf(0x3d);
    if (equals < 0) throw new ReadFailure("index_damaged", "a field without a value");
    fields.set(TEXT.decode(field.subarray(0, equals)), field.subarray(equals + 1));
    at += 4 + field.length;
  }
  return fields;
}

export function uint32(bytes: Uint8Array | undefined, at = 0): number {
  if (bytes === undefined || at < 0 || at + 4 > bytes.length) throw new ReadFailure("index_damaged", "a record is cut off");
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength).getUint32(at, true);
}

export function uint64(bytes: Uint8Array | undefined): number {
  return uint32(bytes) + uint32(bytes, 4) * 2 ** 32;
}

/** Nanoseconds of a time. */
export function timeAt(bytes: Uint8Array | undefined, at = 0): bigint {
  return BigInt(uint32(bytes, at)) * 1_000_000_000n + BigInt(uint32(bytes, at + 4));
}

export function text(bytes: Uint8Array | undefined): string {
  return bytes === undefined ? "" : TEXT.decode(bytes);
}

function sized(bytes: Uint8Array, at: number): Uint8Array {
  const length = uint32(bytes, at);
  const start = at + 4;
  if (start + length > bytes.length) throw new ReadFailure("index_damaged", "a record is cut off");
  return bytes.subarray(start, start + length);
}
