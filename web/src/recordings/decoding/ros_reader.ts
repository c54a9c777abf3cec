/** Primitives of ROS 1 and CDR (XCDR1), within the bytes of one message.
 *
 * Source: wiki.ros.org/msg (ROS 1); OMG DDS-XTYPES 1.3, 7.4.1 (XCDR1), as rmw implementations write it.
 */

import { ReadFailure } from "../failures";
import type { Numbers } from "./value";

interface Kind {
  size: number;
  get: (view: DataView, at: number, little: boolean) => number;
  array: (length: number) => Numbers;
}

const NANOSECONDS = 1e-9;
const TEXT = new TextDecoder();

/** Numeric types by their names in ROS. 64-bit integers become doubles. */
const KINDS: Readonly<Record<string, Kind>> = {
  bool: { size: 1, get: (view, at) => view.getUint8(at), array: (n) => new Uint8Array(n) },
  uint8: { size: 1, get: (view, at) => view.getUint8(at), array: (n) => new Uint8Array(n) },
  int8: { size: 1, get: (view, at) => view.getInt8(at), array: (n) => new Int8Array(n) },
  uint16: { size: 2, get: (view, at, little) => view.getUint16(at, little), array: (n) => new Uint16Array(n) },
  int16: { size: 2, get: (view, at, little) => view.getInt16(at, little), array: (n) => new Int16Array(n) },
  uint32: { size: 4, get: (view, at, little) => view.getUint32(at, little), array: (n) => new Uint32Array(n) },
  int32: { size: 4, get: (view, at, little) => view.getInt32(at, little), array: (n) => new Int32Array(n) },
  uint64: { size: 8, get: (view, at, little) => Number(view.getBigUint64(at, little)), array: (n) => new Float64Array(n) },
  int64: { size: 8, get: (view, at, little) => Number(view.getBigInt64(at, little)), array: (n) => new Float64Array(n) },
  float32: { size: 4, get: (view, at, little) => view.getFloat32(at, little), array: (n) => new Float32Array(n) },
  float64: { size: 8, get: (view, at, little) => view.getFloat64(at, little), array: (n) => new Float64Array(n) },
};

export function kindOf(type: string): Kind | undefined {
  return Object.hasOwn(KINDS, type) ? KINDS[type] : undefined;
}

/** A cursor over one message. `aligned`: CDR, whose first four bytes say how it is written. */
export class RosReader {
  private readonly view: DataView;
  private readonly origin: number;
  private readonly little: boolean;
  private at: number;

  constructor(
    private readonly bytes: Uint8Array,
    readonly aligned: boolean,
  ) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.origin = aligned ? 4 : 0;
    this.at = this.origin;
    if (bytes.length < this.origin) throw damaged(0);
    const kind = aligned ? this.view.getUint16(0) : 1;
    if (kind > 1) throw new ReadFailure("encoding_unknown", `CDR 0x${kind.toString(16).padStart(4, "0")}`);
    this.little = kind === 1;
  }

  one(kind: Kind): number {
    this.align(kind.size);
    const start = this.take(kind.size);
    return kind.get(this.view, start, this.little);
  }

  many(kind: Kind, count: number): Numbers {
    if (count > 0) this.align(kind.size);
    const start = this.take(kind.size * count);
    if (kind.size === 1 && kind !== KINDS.int8) return this.bytes.subarray(start, start + count);
    const values = kind.array(count);
    for (let number = 0; number < count; number++) values[number] = kind.get(this.view, start + number * kind.size, this.little);
    return values;
  }

  /** The length of a sequence. */
  count(): number {
    return this.one(KINDS.uint32 as Kind);
  }

  /** Seconds. */
  time(isSigned: boolean): number {
    const seconds = this.one(KINDS[isSigned ? "int32" : "uint32"] as Kind);
    return seconds + this.one(KINDS[isSigned && !this.aligned ? "int32" : "uint32"] as Kind) * NANOSECONDS;
  }

  string(): string {
    const length = this.count();
    const start = this.take(length);
    const end = this.aligned && length > 0 ? start + length - 1 : start + length; // CDR counts a final zero
    return TEXT.decode(this.bytes.subarray(start, end));
  }

  skip(count: number): void {
    this.take(count);
  }

  private align(size: number): void {
    if (this.aligned) this.at += (size - ((this.at - this.origin) % size)) % size;
  }

  private take(count: number): number {
    const start = this.at;
    if (start + count > this.bytes.length) throw damaged(start);
    this.at = start + count;
    return start;
  }
}

function damaged(at: number): ReadFailure {
  return new ReadFailure("message_damaged", `ends at byte ${at}`);
}
