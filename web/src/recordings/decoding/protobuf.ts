/** Protobuf messages, decoded with the descriptors in the recording.
 *
 * Source: protobuf.dev/programming-guides/encoding, and google/protobuf/descriptor.proto for the numbers of its fields.
 */

import { ReadFailure } from "../failures";
import { MAX_DEPTH, MAX_VALUES } from "../limits";
import type { Decode, Value } from "./decoder";

interface Field {
  name: string;
  type: number;
  typeName: string;
  /** The message that the field is in: names without a leading dot are looked up from there outwards. */
  scope: string;
  isRepeated: boolean;
  /** Absent means its default, which is not written. */
  hasDefault: boolean;
}

type Fields = Map<number, Field>;

const TYPE = { string: 9, group: 10, message: 11, bytes: 12 } as const;
const LABEL_REPEATED = 3;

/** Return how to decode messages called `name` of a FileDescriptorSet.
 *
 * @throws ReadFailure definition_unreadable.
 */
export function protobufDecoder(descriptors: Uint8Array, name: string): Decode {
  const types = new Map<string, Fields>(wellKnown());
  for (const [number, file] of new WireReader(descriptors).records()) if (number === 1) addFile(types, bytesOf(file));
  const root = types.get(`.${name.replace(/^\./, "")}`);
  if (root === undefined) throw new ReadFailure("definition_unreadable", name.slice(0, 100));
  return (data) => decode(data, root, types, { values: MAX_VALUES, depth: MAX_DEPTH });
}

function addFile(types: Map<string, Fields>, file: Uint8Array): void {
  const records = [...new WireReader(file).records()];
  const text = (number: number): string => textOf(records.find(([decoded]) => decoded === number)?.[1]);
  const prefix = text(2) === "" ? "" : `.${text(2)}`;
  const isProto3 = text(12) === "proto3";
  for (const [number, record] of records) if (number === 4) addType(types, bytesOf(record), prefix, isProto3, MAX_DEPTH);
}

function addType(types: Map<string, Fields>, type: Uint8Array, prefix: string, isProto3: boolean, depth: number): void {
  if (depth === 0) throw new ReadFailure("definition_unreadable", "it nests too deep");
  const records = [...new WireReader(type).records()];
  const name = `${prefix}.${textOf(records.find(([number]) => number === 1)?.[1])}`;
  const fields: Fields = new Map();
  for (const [number, record] of records) {
    if (number === 2) addField(fields, bytesOf(record), name, isProto3);
    if (number === 3) addType(types, bytesOf(record), name, isProto3, depth - 1);
  }
  types.set(name, fields);
}

function addField(fields: Fields, field: Uint8Array, scope: string, isProto3: boolean): void {
  const about = new Map(new WireReader(field).records());
  const number = (key: number): number => numberOf(about.get(key));
  const isRepeated = number(4) === LABEL_REPEATED;
  fields.set(number(3), {
    name: textOf(about.get(1)),
    type: number(5),
    typeName: textOf(about.get(6)),
    scope,
    isRepeated,
    hasDefault: isProto3 && !isRepeated && !about.has(9) && number(5) !== TYPE.message && number(5) !== TYPE.group,
  });
}

/** The type of a field. Source: descriptor.proto, `FieldDescriptorProto.type_name`. */
function resolved({ typeName, scope }: Field, types: Map<string, Fields>): Fields | undefined {
  if (typeName.startsWith(".")) return types.get(typeName);
  for (let around = scope; ; around = around.slice(0, around.lastIndexOf("."))) {
    const decoded = types.get(`${around}.${typeName}`);
    if (decoded !== undefined || around === "") return decoded;
  }
}

/** Google's own messages, which writers may leave out of the set. Source: google/protobuf/*.proto. */
function wellKnown(): [string, Fields][] {
  const scalar = (name: string, type: number): Field => ({ name, type, typeName: "", scope: "", isRepeated: false, hasDefault: true });
  const message = (...fields: Field[]): Fields => new Map(fields.map((field, at) => [at + 1, field]));
  const wrappers = { Double: 1, Float: 2, Int64: 3, UInt64: 4, Int32: 5, Bool: 8, String: 9, Bytes: 12, UInt32: 13 };
  return [
    [".google.protobuf.Timestamp", message(scalar("seconds", 3), scalar("nanos", 5))],
    [".google.protobuf.Duration", message(scalar("seconds", 3), scalar("nanos", 5))],
    [".google.protobuf.Any", message(scalar("type_url", TYPE.string), scalar("value", TYPE.bytes))],
    [".google.protobuf.Empty", message()],
    ...Object.entries(wrappers).map(([name, type]): [string, Fields] => [`.google.protobuf.${name}Value`, message(scalar("value", type))]),
  ];
}

function decode(data: Uint8Array, fields: Fields, types: Map<string, Fields>, budget: { values: number; depth: number }): Value {
  if (budget.depth === 0) throw new ReadFailure("message_damaged", "it nests too deep");
  budget.depth -= 1;
  const value: Record<string, Value> = Object.create(null) as Record<string, Value>;
  for (const field of fields.values()) {
    if (field.isRepeated) value[field.name] = [];
    else if (field.hasDefault) value[field.name] = defaultOf(field.type);
  }
  for (const [number, record] of new WireReader(data).records()) {
    const field = fields.get(number);
    if (field === undefined) continue;
    const decoded = one(field, record, types, budget);
    const before = value[field.name];
    if (!field.isRepeated) value[field.name] = decoded[0] ?? null;
    else if (Array.isArray(before)) for (const item of decoded) before.push(item);
    budget.values -= decoded.length;
    if (budget.values < 0) throw new ReadFailure("message_damaged", "it holds too many values");
  }
  budget.depth += 1;
  return value;
}

/** The value of one record; of packed numbers, all. */
function one(field: Field, record: Uint8Array | bigint, types: Map<string, Fields>, budget: { values: number; depth: number }): Value[] {
  if (field.type === TYPE.message || field.type === TYPE.group) {
    const inner = resolved(field, types);
    if (inner === undefined) throw new ReadFailure("definition_unreadable", field.typeName.slice(0, 100));
    return [decode(bytesOf(record), inner, types, budget)];
  }
  if (field.type === TYPE.string) return [textOf(record)];
  if (field.type === TYPE.bytes) return [bytesOf(record)];
  if (typeof record !== "bigint") return field.isRepeated ? new WireReader(record).packed(field.type) : [];
  return [WireReader.number(field.type, record)];
}

function defaultOf(type: number): Value {
  if (type === TYPE.string) return "";
  return type === TYPE.bytes ? new Uint8Array() : 0;
}

function bytesOf(record: Uint8Array | bigint | undefined): Uint8Array {
  if (record instanceof Uint8Array) return record;
  throw new ReadFailure("message_damaged", "a field of another kind");
}

function textOf(record: Uint8Array | bigint | undefined): string {
  return record === undefined ? "" : new TextDecoder().decode(bytesOf(record));
}

function numberOf(record: Uint8Array | bigint | undefined): number {
  return typeof record === "bigint" ? Number(record) : 0;
}

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
      yield [Math.floor(tag / 8), wire === WIRE.startGroup ? this.group(Math.floor(tag / 8), MAX_DEPTH) : this.body(wire)];
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
