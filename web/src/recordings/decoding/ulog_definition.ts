/** Formats of ULog messages, such as "uint64_t timestamp;float[3] xyz": their fields, and the same as a ROS 1 definition. */

import { ReadFailure } from "../failures";

interface UlogField {
  type: string;
  /** Of an array; null: a single value. */
  length: number | null;
  name: string;
}

const FIELD = /^(\w+)(?:\[(\d{1,5})\])? (\w+)$/;
const SIZES: Readonly<Record<string, number>> = {
  int8_t: 1, uint8_t: 1, bool: 1, char: 1, int16_t: 2, uint16_t: 2, int32_t: 4, uint32_t: 4, float: 4, int64_t: 8, uint64_t: 8, double: 8,
};
const ROS_TYPES: Readonly<Record<string, string>> = { float: "float32", double: "float64", char: "uint8" };
const SEPARATOR = `\n${"=".repeat(80)}\n`;
const MAX_NESTING = 20;

/** The formats of a log: fields as the file has them, by the name of the message. */
export type UlogFormats = ReadonlyMap<string, string>;

/** Returns the fields of a format; invalid ones are left out. */
function fieldsOf(text: string): UlogField[] {
  return text.split(";").flatMap((entry) => {
    const [, type, length, name] = FIELD.exec(entry.trim()) ?? [];
    return type === undefined || name === undefined ? [] : [{ type, length: length === undefined ? null : Number(length), name }];
  });
}

/** Returns the bytes that a type takes; null where its format is unknown or contains itself. */
function sizeOf(formats: UlogFormats, type: string, sizes: Map<string, number | null>, depth = 0): number | null {
  const known = Object.hasOwn(SIZES, type) ? SIZES[type] : sizes.get(type);
  if (known !== undefined) return known;
  const fields = formats.get(type);
  if (fields === undefined || depth === MAX_NESTING) return null;
  sizes.set(type, null); // a type that contains itself has no size
  let size: number | null = 0;
  for (const field of fieldsOf(fields)) {
    const inner = sizeOf(formats, field.type, sizes, depth + 1);
    size = inner === null || size === null ? null : size + inner * (field.length ?? 1);
  }
  sizes.set(type, size);
  return size;
}

/** Returns the offset of the field `timestamp` in a message of a format; null where it has none. */
export function stampOffset(formats: UlogFormats, name: string): number | null {
  const sizes = new Map<string, number | null>();
  let offset = 0;
  for (const field of fieldsOf(formats.get(name) ?? "")) {
    if (field.name === "timestamp") return field.type === "uint64_t" && field.length === null ? offset : null;
    const size = sizeOf(formats, field.type, sizes);
    if (size === null) return null;
    offset += size * (field.length ?? 1);
  }
  return null;
}

/** Returns the format of a message and those that it nests, one a line, as the file has them. */
export function definitionOf(formats: UlogFormats, name: string): string {
  const needed = new Set([name]);
  // Grows by all types that a format mentions.
  for (const outer of needed) for (const { type } of fieldsOf(formats.get(outer) ?? "")) needed.add(type);
  return [...needed].flatMap((one) => (formats.has(one) ? [`${one}:${formats.get(one) ?? ""}`] : [])).join("\n");
}

/** Returns a definition as one of ROS 1: messages are laid out alike, but for padding at the end.
 *
 * @throws ReadFailure definition_missing.
 */
export function asRos1Definition(name: string, definition: string): string {
  const formats = new Map(definition.split("\n").map((line) => [line.slice(0, line.indexOf(":")), line.slice(line.indexOf(":") + 1)] as const));
  const own = formats.get(name);
  if (own === undefined) throw new ReadFailure("definition_missing", name);
  formats.delete(name);
  return [rosFields(own, true), ...[...formats].map(([nested, fields]) => `MSG: ulog/${nested}\n${rosFields(fields, false)}`)].join(SEPARATOR);
}

function rosFields(text: string, isTop: boolean): string {
  const fields = fieldsOf(text);
  while (isTop && fields.at(-1)?.name.startsWith("_padding") === true) fields.pop();
  return fields.map(({ type, length, name }) => `${rosType(type)}${length === null ? "" : `[${length}]`} ${rosName(name)}`).join("\n");
}

function rosType(type: string): string {
  return Object.hasOwn(SIZES, type) ? (ROS_TYPES[type] ?? type.replace(/_t$/, "")) : `ulog/${type}`;
}

/** ROS allows no name that begins with "_", as that of padding does. */
function rosName(name: string): string {
  return name.startsWith("_") ? `${name.replace(/^_+/, "")}_` : name;
}
