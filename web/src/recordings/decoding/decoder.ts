/** Decoded values, and the decoder of a channel by its encodings. */

import { isZstd, unpack, zstdContentSize } from "../compression/unpack";
import { failureOf, ReadFailure } from "../failures";
import type { Schema } from "../formats/recording";
import { MAX_DEFINITION } from "../limits";
import { protobufDecoder } from "./protobuf";
import { rosDecoder } from "./ros";
import { asRos1Definition } from "./ulog_definition";
import { wellKnownDefinitions } from "./well_known";

const TEXT = new TextDecoder();

/** Return how to decode the messages of a channel.
 *
 * @throws ReadFailure encoding_unknown, definition_missing, definition_unreadable.
 */
export function decoderOf(schema: Schema): Decode {
  const { encoding, messageEncoding, definition } = schema;
  if (definition.length > MAX_DEFINITION) throw new ReadFailure("too_large", String(definition.length));
  if (messageEncoding === "json") return fromJson;
  if (messageEncoding === "protobuf" && encoding === "protobuf") return protobufDecoder(definition, schema.name);
  if (messageEncoding === "ros1" && encoding === "ros1msg") return rosDecoder(TEXT.decode(definition), 1, false);
  if (messageEncoding === "ulog" && encoding === "ulog") return rosDecoder(asRos1Definition(schema.name, TEXT.decode(definition)), 1, false);
  if (messageEncoding === "cdr" && encoding === "ros2msg") return unpacking(rosDecoder(withService(TEXT.decode(definition), schema.name), 2, true));
  if (messageEncoding === "cdr" && encoding === "") return unpacking(wellKnownDecoder(schema.name));
  throw new ReadFailure("encoding_unknown", [messageEncoding, encoding].filter((word) => word !== "").join(", ").slice(0, 80));
}

/** Decode messages of a well-known type by the first of its definitions that fits, or by the only other one.
 *
 * @throws ReadFailure definition_missing, where the type is not well-known.
 */
function wellKnownDecoder(name: string): Decode {
  const definitions = wellKnownDefinitions(name);
  if (definitions.length === 0) throw new ReadFailure("definition_missing", name);
  const [first, ...others] = definitions.map((definition) => rosDecoder(definition, 2, true, definitions.length > 1)) as [Decode, ...Decode[]];
  return (data) => {
    try {
      return first(data);
    } catch (thrown) {
      const fitting = others.flatMap((decode) => {
        try {
          return [decode(data)];
        } catch {
          return [];
        }
      });
      const [only] = fitting;
      if (only === undefined || fitting.length > 1) throw thrown;
      return only;
    }
  };
}

/** Decode messages that rosbag2 may have compressed one by one. No CDR begins as zstd does. */
function unpacking(decode: Decode): Decode {
  return (data) => {
    if (!isZstd(data)) return decode(data);
    const size = zstdContentSize(data);
    if (size === null) throw new ReadFailure("message_damaged", "a compressed message without its size");
    try {
      return decode(unpack("zstd", data, size));
    } catch (thrown) {
      const failure = failureOf(thrown, "message_damaged");
      throw failure.code === "chunk_damaged" ? new ReadFailure("message_damaged", failure.detail) : failure;
    }
  };
}

function fromJson(data: Uint8Array): Value {
  try {
    return JSON.parse(TEXT.decode(data)) as Value;
  } catch {
    throw new ReadFailure("message_damaged", "no JSON");
  }
}

export type Numbers =
  | Uint8Array
  | Int8Array
  | Uint16Array
  | Int16Array
  | Uint32Array
  | Int32Array
  | Float32Array
  | Float64Array;

export type Value = number | boolean | string | null | Numbers | Value[] | { [name: string]: Value };

/** Turns the bytes of a message into its value.
 *
 * @throws ReadFailure message_damaged where they do not fit the definition.
 */
export type Decode = (data: Uint8Array) => Value;

export function isNumbers(value: Value | undefined): value is Numbers {
  return ArrayBuffer.isView(value);
}

export function isFields(value: Value | undefined): value is { [name: string]: Value } {
  return typeof value === "object" && value !== null && !Array.isArray(value) && !isNumbers(value);
}

const RULE = /^=+[ \t]*$/m;
const PARTED = /^---[ \t]*$/m;
const INFO = `uint8 event_type
builtin_interfaces/Time stamp
uint8[16] client_gid
int64 sequence_number
`;

/** Return a definition that a parser of messages can follow; a text that is no service's stays as it is. */
export function withService(definition: string, name: string): string {
  const rule = RULE.exec(definition);
  const own = rule === null ? definition : definition.slice(0, rule.index);
  const others = rule === null ? "" : definition.slice(rule.index);
  const sections = own.split(PARTED);
  const [request, response] = sections;
  if (sections.length !== 2 || request === undefined || response === undefined) return definition;
  if (/_Request$/.test(name)) return `${request}\n${others}`;
  if (/_Response$/.test(name)) return `${response}\n${others}`;
  const base = name.replace(/_Event$/, "");
  const info = /^MSG: service_msgs\/(msg\/)?ServiceEventInfo\s*$/m.test(others) ? "" : block("service_msgs/msg/ServiceEventInfo", INFO);
  const event = `service_msgs/msg/ServiceEventInfo info\n${base}_Request[] request\n${base}_Response[] response\n`;
  return event + block(`${base}_Request`, request) + block(`${base}_Response`, response) + info + others;
}

function block(name: string, text: string): string {
  return `${"=".repeat(80)}\nMSG: ${name}\n${text}\n`;
}
