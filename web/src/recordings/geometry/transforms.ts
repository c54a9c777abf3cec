/** Transforms (tf) in messages. Source: tf2_msgs/TFMessage, geometry_msgs/TransformStamped, foxglove.FrameTransform. */

import { isFields, type Value } from "../decoding/decoder";
import { MAX_TRANSFORMS } from "../limits";
import type { Pose } from "./poses";
import { frameName, frameOf, listOf, part, poseOf, stampOf } from "./values";

/** The pose of frame `child` in frame `parent` at a time. */
export interface Transform {
  readonly parent: string;
  readonly child: string;
  /** Null where the message has no stamp. */
  readonly stampSeconds: number | null;
  readonly pose: Pose;
}

const NAME = /^(tf2_msgs\/(msg\/)?TFMessage|tf\/tfMessage|foxglove(\.|_msgs\/(msg\/)?)FrameTransforms?)$/;

/** Whether messages of a type are transforms. */
export function isTransformType(messageType: string | null): boolean {
  return messageType !== null && NAME.test(messageType);
}

/** Whether transforms of a topic are valid at all times. */
export function isStaticTopic(topic: string): boolean {
  return /(^|\/)tf_static$/.test(topic);
}

/** Return the usable transforms of a message: with two frames, finite numbers and a rotation. */
export function transformsOf(message: Value): readonly Transform[] {
  const items = isFields(message) && Array.isArray(message.transforms) ? listOf(message.transforms) : [message];
  return items.slice(0, MAX_TRANSFORMS).flatMap((item) => transformOf(item) ?? []);
}

function transformOf(item: Value): Transform | null {
  const outer = part(item, "transform") ?? item;
  const pose = poseOf(outer, ["translation", "rotation"]);
  const parent = frameName(part(item, "parent_frame_id")) || frameOf(item);
  const child = frameName(part(item, "child_frame_id"));
  if (pose === null || parent === "" || child === "" || parent === child) return null;
  return { parent, child, stampSeconds: stampOf(item), pose };
}
