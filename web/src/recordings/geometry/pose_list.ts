/** Poses in messages: geometry_msgs, nav_msgs, foxglove. */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import type { Pose } from "./poses";
import { listOf, part, poseOf } from "./values";

export interface PoseSequence {
  readonly poses: readonly Pose[];
  /** Whether they are connected by a line. */
  readonly isPath: boolean;
  /** Poses with NaN or without a rotation. */
  readonly invalidPoses: number;
}

/** Return the poses of a path or an array. */
export function poseSequence(message: Value, isPath: boolean): PoseSequence {
  const items = listOf(part(message, "poses"));
  const poses = items.flatMap((item) => poseOf(part(item, "pose") ?? item) ?? []);
  return { poses, isPath, invalidPoses: items.length - poses.length };
}

/** Return the one pose of a message, which may have a covariance around it.
 *
 * @throws ReadFailure pose_unreadable.
 */
export function singlePose(message: Value): PoseSequence {
  const outer = part(message, "pose") ?? message;
  const pose = poseOf(part(outer, "pose") ?? outer) ?? poseOf(part(message, "transform"), ["translation", "rotation"]);
  if (pose === null) throw new ReadFailure("pose_unreadable");
  return { poses: [pose], isPath: false, invalidPoses: 0 };
}
