/** Which decoder a channel takes. */

import { isZstd, unpack, zstdContentSize } from "../compression/unpack";
import { failureOf, ReadFailure } from "../failures";
import type { Schema } from "../formats/recording";
import { MOST_DEFINITION } from "../limits";
import { protobufDecoder } from "./protobuf";
import { rosDecoder } from "./ros";
import { withService } from "./service";
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
  if (messageEncoding === "cdr" && encoding === "ros2msg") return unpacking(rosDecoder(withService(TEXT.decode(definition), schema.name), 2, true));
  throw new ReadFailure("encoding_unknown", [messageEncoding, encoding].filter((word) => word !== "").join(", ").slice(0, 80));
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
