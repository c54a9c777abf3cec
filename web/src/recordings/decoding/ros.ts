/** ROS 1 and ROS 2 messages, decoded with the definitions in the recording. The CSP forbids generated code. */

import type { MessageDefinition, MessageDefinitionField } from "@foxglove/message-definition";
import { parse } from "@foxglove/rosmsg";
import { failureOf, ReadFailure } from "../failures";
import { MAX_DEPTH, MAX_VALUES } from "../limits";
import type { Decode, Numbers, Value } from "./decoder";

interface Field {
  name: string;
  read: (reader: RosReader, budget: Budget) => Value;
}

/** What of one message is decoded at most. */
interface Budget {
  values: number;
  depth: number;
}

/** Return how to decode messages of a definition; `ros` is that of the definition, `aligned` is CDR.
 *
 * `isWhole`: a message of which bytes are left over is damaged.
 *
 * @throws ReadFailure definition_unreadable.
 */
export function rosDecoder(definition: string, ros: 1 | 2, aligned: boolean, isWhole = false): Decode {
  let definitions: MessageDefinition[];
  try {
    definitions = parse(definition, { ros2: ros === 2 });
  } catch (thrown) {
    throw failureOf(thrown, "definition_unreadable");
  }
  const [root] = definitions;
  if (root === undefined) throw new ReadFailure("definition_unreadable", "it is empty");
  const structure = new Structures(definitions, aligned).of(root);
  return (data) => {
    const reader = new RosReader(data, aligned);
    const value = structure(reader, { values: MAX_VALUES, depth: MAX_DEPTH });
    if (isWhole && reader.restBytes > MAX_PADDING) throw new ReadFailure("message_damaged", `${reader.restBytes} bytes are left over`);
    return value;
  };
}

/** Readers of structures, each made once; a type may hold itself only in arrays that end. */
class Structures {
  private readonly byName = new Map<string, MessageDefinition>();
  private readonly made = new Map<MessageDefinition, Field[]>();

  constructor(
    definitions: readonly MessageDefinition[],
    private readonly aligned: boolean,
  ) {
    for (const definition of definitions) if (definition.name !== undefined) this.byName.set(definition.name, definition);
  }

  of(definition: MessageDefinition): Field["read"] {
    let fields = this.made.get(definition);
    if (fields === undefined) {
      fields = [];
      this.made.set(definition, fields); // before its fields, which may lead back to it
      for (const field of definition.definitions) {
        if (field.isConstant !== true) fields.push({ name: field.name, read: this.field(field) });
      }
    }
    const known = fields;
    return (reader, budget) => this.structure(known, reader, budget);
  }

  private structure(fields: readonly Field[], reader: RosReader, budget: Budget): Value {
    if (budget.depth === 0) throw new ReadFailure("message_damaged", "it nests too deep");
    budget.depth -= 1;
    if (fields.length === 0 && this.aligned) reader.skip(1); // ROS 2 writes one byte for an empty structure
    const value: Record<string, Value> = Object.create(null) as Record<string, Value>;
    for (const { name, read } of fields) value[name] = read(reader, budget);
    budget.depth += 1;
    return value;
  }

  private field(field: MessageDefinitionField): Field["read"] {
    const kind = kindOf(field.type);
    if (field.isArray !== true) return kind === undefined ? this.single(field) : (reader) => reader.one(kind);
    const { arrayLength } = field;
    const count = (reader: RosReader): number => (typeof arrayLength === "number" ? arrayLength : reader.count());
    if (kind !== undefined) return (reader) => reader.many(kind, count(reader));
    const element = this.single(field);
    return (reader, budget) => {
      const length = count(reader);
      budget.values -= length;
      if (budget.values < 0) throw new ReadFailure("message_damaged", "it holds too many values");
      return Array.from({ length }, () => element(reader, budget));
    };
  }

  private single(field: MessageDefinitionField): Field["read"] {
    if (field.type === "string") return (reader) => reader.string();
    if (field.type === "time" || field.type === "duration") {
      const isSigned = this.aligned || field.type === "duration";
      return (reader) => reader.time(isSigned);
    }
    const definition = this.byName.get(field.type);
    if (definition === undefined) throw new ReadFailure("definition_unreadable", field.type);
    return this.of(definition);
  }
}

interface Kind {
  size: number;
  get: (view: DataView, at: number, little: boolean) => number;
  array: (length: number) => Numbers;
}

const NANOSECONDS = 1e-9;
/** Middlewares fill the last word of a message. */
const MAX_PADDING = 3;
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

/** A cursor over one message. `aligned`: CDR, whose first four bytes declare the byte order. */
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

  get restBytes(): number {
    return this.bytes.length - this.at;
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
