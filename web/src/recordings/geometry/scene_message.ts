/** What a message shows in space, by its type. To add a type, add its row here. */

import type { Value } from "../decoding/decoder";
import { ReadFailure } from "../failures";
import { laserScan } from "./laser_scan";
import { markerBuffers, markerChanges, type MarkerChange } from "./markers";
import { occupancyGrid, type GridImage } from "./occupancy_grid";
import { foxglovePointCloud, pointCloud2 } from "./point_cloud";
import { buffersOf, type PointSet } from "./points";
import { poseSequence, singlePose, type PoseSequence } from "./pose_list";
import { IDENTITY, type Pose } from "./poses";
import { frameOf, stampOf } from "./values";

export type SceneContent =
  | { readonly kind: "points"; readonly points: PointSet; /** The pose of the points in the frame. */ readonly pose: Pose }
  | { readonly kind: "poses"; readonly sequence: PoseSequence }
  | { readonly kind: "grid"; readonly grid: GridImage }
  | { readonly kind: "markers"; readonly changes: readonly MarkerChange[] };

export interface SceneMessage {
  /** The frame of the content; markers have their own. */
  readonly frame: string;
  readonly stampSeconds: number | null;
  readonly content: SceneContent;
}

type Show = (message: Value) => SceneContent;

const points = (content: PointSet): SceneContent => ({ kind: "points", points: content, pose: IDENTITY });
const onePose: Show = (message) => ({ kind: "poses", sequence: singlePose(message) });
const markers: Show = (message) => ({ kind: "markers", changes: markerChanges(message) });

/** By type without `msg/`. */
const SHOWN: Readonly<Record<string, Show>> = {
  "sensor_msgs/PointCloud2": (message) => points(pointCloud2(message)),
  "foxglove.PointCloud": (message) => ({ kind: "points", ...foxglovePointCloud(message) }),
  "sensor_msgs/LaserScan": (message) => points(laserScan(message)),
  "nav_msgs/Path": (message) => ({ kind: "poses", sequence: poseSequence(message, true) }),
  "geometry_msgs/PoseArray": (message) => ({ kind: "poses", sequence: poseSequence(message, false) }),
  "geometry_msgs/PoseStamped": onePose,
  "geometry_msgs/PoseWithCovarianceStamped": onePose,
  "foxglove.PoseInFrame": onePose,
  "nav_msgs/Odometry": onePose,
  "nav_msgs/OccupancyGrid": (message) => ({ kind: "grid", grid: occupancyGrid(message) }),
  "visualization_msgs/Marker": markers,
  "visualization_msgs/MarkerArray": markers,
};

function showOf(messageType: string): Show | undefined {
  const name = messageType.replace("/msg/", "/").replace(/^foxglove_msgs\//, "foxglove.");
  return Object.hasOwn(SHOWN, name) ? SHOWN[name] : undefined;
}

/** Whether messages of a type are shown in space. */
export function isSceneType(messageType: string | null): boolean {
  return messageType !== null && showOf(messageType) !== undefined;
}

/** Return what a message shows.
 *
 * @throws ReadFailure cloud_unreadable, pose_unreadable, grid_unreadable, not_spatial.
 */
export function sceneMessage(messageType: string, message: Value): SceneMessage {
  const show = showOf(messageType);
  if (show === undefined) throw new ReadFailure("not_spatial", messageType.slice(0, 100));
  return { frame: frameOf(message), stampSeconds: stampOf(message), content: show(message) };
}

/** Return the buffers of a message, to be moved to the page. */
export function sceneBuffers({ content }: SceneMessage): ArrayBuffer[] {
  if (content.kind === "points") return buffersOf(content.points);
  if (content.kind === "grid") return [content.grid.cells.buffer];
  return content.kind === "markers" ? markerBuffers(content.changes) : [];
}
