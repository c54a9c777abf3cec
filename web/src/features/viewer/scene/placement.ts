// What is visible and where: the contents of topics, placed in the fixed frame at the times of their stamps.
import type { Marker } from "@/recordings/geometry/markers";
import { followedBy, type Pose } from "@/recordings/geometry/poses";
import type { SceneContent, SceneMessage } from "@/recordings/geometry/scene_message";
import type { MissingTransform, TransformBuffer } from "@/recordings/geometry/transform_buffer";

/** A message, and when it was logged. */
export interface TimedScene {
  readonly logTimeNs: bigint;
  readonly logSeconds: number;
  readonly scene: SceneMessage;
}

/** What a topic shows now, the latest message last. */
export interface TopicContent {
  readonly topic: string;
  readonly messages: readonly TimedScene[];
  readonly markers: readonly Marker[];
  readonly colourBy: string | null;
  /** Whether a preview gives what is shown instead of the messages. */
  readonly isRough: boolean;
}

/** Something visible. `item` identifies it: it is drawn once and only moved afterwards. */
export interface PlacedItem {
  readonly item: Exclude<SceneContent, { kind: "markers" }> | Marker;
  readonly pose: Pose;
  readonly colourBy: string | null;
}

export interface Placement {
  readonly items: readonly PlacedItem[];
  /** Why some content is not visible, once for each frame. */
  readonly missing: readonly MissingTransform[];
  /** Whether something is placed by a transform of another time. */
  readonly isExtrapolated: boolean;
}

const NS_PER_S = 1e9;

export function secondsOfNs(timeNs: bigint): number {
  return Number(timeNs) / NS_PER_S;
}

/** Returns the frame that does not move: the chosen one, or the root above what is shown first. */
export function fixedFrameOf(chosen: string | null, contents: readonly TopicContent[], transforms: TransformBuffer): string {
  if (chosen !== null) return chosen;
  for (const { messages, markers } of contents) {
    const frame = markers[0]?.frame ?? messages.at(-1)?.scene.frame;
    if (frame !== undefined) return transforms.rootOf(frame);
  }
  return transforms.rootOf(transforms.frames[0] ?? "");
}

/** Returns the items of topics in a frame. `nowSeconds` is the time of markers that move with their frames. */
export function placed(contents: readonly TopicContent[], fixedFrame: string, transforms: TransformBuffer, nowSeconds: number): Placement {
  const items: PlacedItem[] = [];
  const missing = new Map<string, MissingTransform>();
  let isExtrapolated = false;
  const place = (item: PlacedItem["item"], frame: string, seconds: number, local: Pose | null, colourBy: string | null): void => {
    const transform = transforms.find(fixedFrame, frame, seconds);
    if (!("pose" in transform)) {
      missing.set(`${transform.reason} ${transform.frame}`, transform);
      return;
    }
    isExtrapolated ||= transform.isExtrapolated;
    items.push({ item, pose: local === null ? transform.pose : followedBy(transform.pose, local), colourBy });
  };
  for (const { messages, markers, colourBy } of contents) {
    for (const { scene, logSeconds } of messages) {
      if (scene.content.kind !== "markers") place(scene.content, scene.frame, scene.stampSeconds ?? logSeconds, localPose(scene.content), colourBy);
    }
    for (const marker of markers) {
      const seconds = marker.isFrameLocked ? nowSeconds : (marker.stampSeconds ?? nowSeconds);
      place(marker, marker.frame, seconds, marker.pose, colourBy);
    }
  }
  return { items, missing: [...missing.values()], isExtrapolated };
}

function localPose(content: SceneContent): Pose | null {
  if (content.kind === "points") return content.pose;
  return content.kind === "grid" ? content.grid.origin : null;
}
