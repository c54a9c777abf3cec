/** Protobuf messages, by the descriptors that the recording carries.
 *
 * Source: protobuf.dev/programming-guides/encoding, and google/protobuf/descriptor.proto for the numbers of its fields.
 */

import { ReadFailure } from "../failures";
import { MOST_DEPTH, MOST_VALUES } from "../limits";
import type { Decode, Value } from "./value";
import { WireReader } from "./wire";

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
  return (data) => decode(data, root, types, { values: MOST_VALUES, depth: MOST_DEPTH });
}

function addFile(types: Map<string, Fields>, file: Uint8Array): void {
  const records = [...new WireReader(file).records()];
  const text = (number: number): string => textOf(records.find(([found]) => found === number)?.[1]);
  const prefix = text(2) === "" ? "" : `.${text(2)}`;
  const isProto3 = text(12) === "proto3";
  for (const [number, record] of records) if (number === 4) addType(types, bytesOf(record), prefix, isProto3, MOST_DEPTH);
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
    const found = types.get(`${around}.${typeName}`);
    if (found !== undefined || around === "") return found;
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
    const found = one(field, record, types, budget);
    const before = value[field.name];
    if (!field.isRepeated) value[field.name] = found[0] ?? null;
    else if (Array.isArray(before)) for (const each of found) before.push(each);
    budget.values -= found.length;
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
