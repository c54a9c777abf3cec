/** The definitions of ROS messages as structures. */

import type { MessageDefinition } from "@foxglove/message-definition";
import { parse } from "@foxglove/rosmsg";
import type { Schema } from "../formats/recording";
import { withService } from "./decoder";
import { wellKnownDefinitions } from "./well_known";

const TEXT = new TextDecoder();

/** Return the definition of a ROS message, then those that it needs; null for other encodings, and where it cannot be parsed. */
export function rosDefinitions({ name, encoding, messageEncoding, definition }: Schema): readonly MessageDefinition[] | null {
  const isRos2 = messageEncoding === "cdr";
  const text = encoding === "" && isRos2 ? wellKnownDefinitions(name)[0] : withService(TEXT.decode(definition), name);
  if (text === undefined || (messageEncoding !== "ros1" && !(isRos2 && ["ros2msg", ""].includes(encoding)))) return null;
  try {
    return parse(text, { ros2: isRos2 });
  } catch {
    return null; // the decoder says why
  }
}
