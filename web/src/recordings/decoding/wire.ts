/** The wire format of protobuf: numbered records, each a number (as its 64 bits) or bytes.
 *
 * Source: protobuf.dev/programming-guides/encoding.
 */

import { ReadFailure } from "../failures";
import { MOST_DEPTH } from "../limits";

const WIRE = { varint: 0, fixed64: 1, bytes: 2, startGroup: 3, endGroup: 4, fixed32: 5 } as const;
const FIXED_64 = new Set([1, 6, 16]);
const FIXED_32 = new Set([2, 7, 15]);
const SIGNED = new Set([3, 5, 14]);
const ZIGZAG = new Set([17, 18]);
const SCRATCH = new DataView(new ArrayBuffer(8));

export class WireReader {
  private readonly view: DataView;
  private at = 0;

  constructor(private readonly bytes: Uint8Array) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  *records(): Generator<[number, Uint8Array | bigint]> {
    while (this.at < this.bytes.length) {
      const tag = Number(this.varint());
      const wire = tag % 8;
      yield [Math.floor(tag / 8), wire === WIRE.startGroup ? this.group(Math.floor(tag / 8), MOST_DEPTH) : this.body(wire)];
    }
  }

  /** The numbers of a packed field of a type of descriptor.proto. */
  packed(type: number): number[] {
    const values: number[] = [];
    const wire = FIXED_64.has(type) ? WIRE.fixed64 : FIXED_32.has(type) ? WIRE.fixed32 : WIRE.varint;
    while (this.at < this.bytes.length) values.push(WireReader.number(type, this.body(wire) as bigint));
    return values;
  }

  /** What 64 bits (32 for fixed 32) mean as a type of descriptor.proto. */
  static number(type: number, bits: bigint): number {
    SCRATCH.setBigUint64(0, BigInt.asUintN(64, bits));
    if (type === 1) return SCRATCH.getFloat64(0);
    if (type === 2) return SCRATCH.getFloat32(4);
    if (type === 15) return SCRATCH.getInt32(4);
    if (type === 16 || SIGNED.has(type)) return Number(BigInt.asIntN(64, bits));
    if (ZIGZAG.has(type)) return Number((bits >> 1n) ^ -(bits & 1n));
    return Number(bits);
  }

  private body(wire: number): Uint8Array | bigint {
    if (wire === WIRE.varint) return this.varint();
    if (wire === WIRE.fixed64) return this.view.getBigUint64(this.take(8), true);
    if (wire === WIRE.fixed32) return BigInt(this.view.getUint32(this.take(4), true));
    if (wire !== WIRE.bytes) throw new ReadFailure("message_damaged", `a protobuf record of kind ${wire}`);
    const length = Number(this.varint());
    const start = this.take(length);
    return this.bytes.subarray(start, start + length);
  }

  /** The bytes of a group, up to the record that ends it. */
  private group(number: number, depth: number): Uint8Array {
    if (depth === 0) throw new ReadFailure("message_damaged", "it nests too deep");
    const start = this.at;
    for (;;) {
      const end = this.at;
      const tag = Number(this.varint());
      const [inner, wire] = [Math.floor(tag / 8), tag % 8];
      if (wire === WIRE.endGroup && inner === number) return this.bytes.subarray(start, end);
      if (wire === WIRE.startGroup) this.group(inner, depth - 1);
      else this.body(wire);
    }
  }

  private varint(): bigint {
    let value = 0n;
    for (let shift = 0n; shift < 70n; shift += 7n) {
      const byte = this.view.getUint8(this.take(1));
      value |= BigInt(byte & 0x7f) << shift;
      if (byte < 0x80) return BigInt.asUintN(64, value);
    }
    throw new ReadFailure("message_damaged", "a protobuf number without an end");
  }

  private take(count: number): number {
    const start = this.at;
    if (start + count > this.bytes.length) throw new ReadFailure("message_damaged", `ends at byte ${start}`);
    this.at = start + count;
    return start;
  }
}
