/** Which decoder a channel takes. */

import { ReadFailure } from "../failures";
import type { Schema } from "../formats/recording";
import { MOST_DEFINITION } from "../limits";
import { protobufDecoder } from "./protobuf";
import { rosDecoder } from "./ros";
import type { Decode, Value } from "./value";

const TEXT = new TextDecoder();

/** Return how to decode the messages of a channel.
 *
 * @throws ReadFailure encoding_unknown, definition_unreadable.
 */
export function decoderOf(schema: Schema): Decode {
  const { encoding, messageEncoding, definition } = schema;
  if (definition.length > MOST_DEFINITION) throw new ReadFailure("too_large", String(definition.length));
  if (messageEncoding === "json") return fromJson;
  if (messageEncoding === "protobuf" && encoding === "protobuf") return protobufDecoder(definition, schema.name);
  if (messageEncoding === "ros1" && encoding === "ros1msg") return rosDecoder(TEXT.decode(definition), 1, false);
  if (messageEncoding === "cdr" && encoding === "ros2msg") return rosDecoder(TEXT.decode(definition), 2, true);
  throw new ReadFailure("encoding_unknown", [messageEncoding, encoding].filter((word) => word !== "").join(", ").slice(0, 80));
}

function fromJson(data: Uint8Array): Value {
  try {
    return JSON.parse(TEXT.decode(data)) as Value;
  } catch {
    throw new ReadFailure("message_damaged", "no JSON");
  }
}
