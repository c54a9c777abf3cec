/** A message as a tree of fields with their types; as bytes, where nothing decodes it. Of bounded size. */

import { isFields, isNumbers, type Numbers, type Value } from "../decoding/decoder";
import { rosDefinitions } from "../decoding/definitions";
import { failureOf, type FailureCode } from "../failures";
import type { Message, Schema } from "../formats/recording";
import { MAX_DEPTH } from "../limits";

export interface TreeNode {
  label: string;
  /** As the definition spells it; where there is none, by the value. */
  type: string;
  /** The value of a leaf; null for a group. */
  text: string | null;
  children: TreeNode[];
  /** Elements or fields that are not shown. */
  hidden: number;
}

export interface MessageTree {
  messageType: string;
  nodes: TreeNode[];
  /** The first bytes in hexadecimal, where the message cannot be decoded, and why. */
  undecoded: { hex: string; code: FailureCode; detail: string } | null;
}

const MAX_NODES = 4_000;
const MAX_ELEMENTS = 100;
const MAX_TEXT = 4_000;
const MAX_BYTES = 1_024;
/** Times are decoded to doubles, which resolve a quarter of a microsecond. */
const TIME_DIGITS = 6;

/** Return the tree of a message. */
export function messageTree({ channel: { schema }, data }: Message, decode: () => Value): MessageTree {
  let value: Value;
  try {
    value = decode();
  } catch (thrown) {
    const { code, detail } = failureOf(thrown, "message_damaged");
    return { messageType: schema.name, nodes: [], undecoded: { hex: hexOf(data), code, detail } };
  }
  const types = typesOf(schema);
  const root = { label: "", type: types?.root ?? "", value };
  return { messageType: schema.name, nodes: new TreeBuilder(types).children(root, MAX_DEPTH).nodes, undecoded: null };
}

/** Names the types of fields by the definition of the message. */
interface Types {
  root: string;
  /** The type of a field of a type, such as `float64[9]`. */
  field: (type: string, name: string) => string | undefined;
}

interface Typed {
  label: string;
  type: string | undefined;
  value: Value;
}

class TreeBuilder {
  private nodesLeft = MAX_NODES;

  constructor(private readonly types: Types | null) {}

  children({ type, value }: Typed, depth: number): { nodes: TreeNode[]; hidden: number } {
    const parts = [...this.partsOf(type, value)];
    const nodes: TreeNode[] = [];
    for (const part of parts.slice(0, MAX_ELEMENTS)) {
      if (this.nodesLeft <= 0) break;
      this.nodesLeft -= 1;
      nodes.push(this.node(part, depth - 1));
    }
    const count = Array.isArray(value) || isNumbers(value) ? value.length : parts.length;
    return { nodes, hidden: count - nodes.length };
  }

  private node(part: Typed, depth: number): TreeNode {
    const { label, value } = part;
    const type = part.type ?? typeByValue(value);
    const isGroup = isFields(value) || Array.isArray(value) || isNumbers(value);
    if (!isGroup || depth === 0) return { label, type, text: isGroup ? "" : leafText(value, type), children: [], hidden: 0 };
    const { nodes, hidden } = this.children({ label, type: part.type, value }, depth);
    return { label, type, text: null, children: nodes, hidden };
  }

  private *partsOf(type: string | undefined, value: Value): Iterable<Typed> {
    if (Array.isArray(value) || isNumbers(value)) {
      const element = type?.replace(/\[[^\]]*\]$/, "") ?? (isNumbers(value) ? numberType(value) : undefined);
      for (let place = 0; place < Math.min(value.length, MAX_ELEMENTS); place += 1) {
        yield { label: `[${place}]`, type: element, value: value[place] ?? null };
      }
    } else if (isFields(value)) {
      for (const [label, inner] of Object.entries(value)) yield { label, type: type === undefined ? undefined : this.types?.field(type, label), value: inner };
    }
  }
}

function leafText(value: Value, type: string): string {
  if (typeof value === "string") return value.length > MAX_TEXT ? `${value.slice(0, MAX_TEXT)}…` : value;
  if (typeof value === "number" && type === "float32") return float32Text(value);
  if (typeof value === "number" && (type === "time" || type === "duration")) return value.toFixed(TIME_DIGITS);
  return typeof value === "object" ? "null" : String(value);
}

/** Return the shortest decimal that is the same number in 32 bits. */
function float32Text(value: number): string {
  for (let digits = 6; digits < 9; digits += 1) {
    const short = Number(value.toPrecision(digits));
    if (Math.fround(short) === value) return String(short);
  }
  return String(Number.isFinite(value) ? Number(value.toPrecision(9)) : value);
}

function typeByValue(value: Value): string {
  if (isNumbers(value)) return `${numberType(value)}[${value.length}]`;
  if (Array.isArray(value)) return `[${value.length}]`;
  if (value === null) return "null";
  if (typeof value === "boolean") return "bool";
  return typeof value === "object" ? "" : typeof value;
}

function numberType(numbers: Numbers): string {
  return numbers.constructor.name.replace("Array", "").toLowerCase();
}

const known = new WeakMap<Schema, Types | null>();

/** Return the types by the definition of a ROS message; null for other encodings, and where it cannot be parsed. */
function typesOf(schema: Schema): Types | null {
  const cached = known.get(schema);
  if (cached !== undefined) return cached;
  const types = rosTypes(schema);
  known.set(schema, types);
  return types;
}

function rosTypes(schema: Schema): Types | null {
  const definitions = rosDefinitions(schema);
  if (definitions === null) return null;
  const byName = new Map(definitions.map((one, place) => [place === 0 ? "" : (one.name ?? ""), one]));
  const field = (type: string, fieldName: string): string | undefined => {
    const match = byName.get(type.replace(/\[[^\]]*\]$/, ""))?.definitions.find((one) => one.name === fieldName && one.isConstant !== true);
    if (match === undefined) return undefined;
    return match.isArray === true ? `${match.type}[${match.arrayLength ?? ""}]` : match.type;
  };
  return { root: "", field };
}

function hexOf(data: Uint8Array): string {
  const bytes = data.subarray(0, MAX_BYTES);
  const rows = Array.from({ length: Math.ceil(bytes.length / 16) }, (_, row) => bytes.subarray(row * 16, row * 16 + 16));
  return rows.map((row) => Array.from(row, (byte) => byte.toString(16).padStart(2, "0")).join(" ")).join("\n");
}
