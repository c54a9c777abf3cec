/** `visualization_msgs/Marker` and `MarkerArray`: changes to a set of shapes, and that set.
 *
 * Source: visualization_msgs/Marker; wiki.ros.org/rviz/DisplayTypes/Marker.
 */

import type { Value } from "../decoding/decoder";
import { MAX_MARKERS, MAX_MARKER_POINTS } from "../limits";
import { IDENTITY, type Pose, type Vector } from "./poses";
import { colourOf, frameOf, listOf, numberOf, part, poseOf, secondsOf, stampOf, textOf, vectorOf, type Colour } from "./values";

/** By `Marker.type`. A mesh is not loaded. */
export const MARKER_SHAPES = [
  "arrow", "cube", "sphere", "cylinder", "line_strip", "line_list", "cube_list", "sphere_list", "points", "text", "mesh", "triangle_list",
] as const;
export type MarkerShape = (typeof MARKER_SHAPES)[number];

/** Points of a marker in metres, relative to `origin`, in the pose of the marker. */
export interface MarkerPoints {
  readonly positions: Float32Array<ArrayBuffer>;
  readonly origin: Vector;
  /** Red, green, blue and alpha of each point, from 0 to 1; null where all have the colour of the marker. */
  readonly colours: Float32Array<ArrayBuffer> | null;
  readonly totalPoints: number;
}

export interface Marker {
  /** Its namespace and id, which identify it on its topic. */
  readonly key: string;
  readonly frame: string;
  readonly stampSeconds: number | null;
  readonly shape: MarkerShape;
  readonly pose: Pose;
  readonly scale: Vector;
  readonly colour: Colour;
  /** Infinity where it has no end. */
  readonly lifetimeSeconds: number;
  /** Whether it moves with its frame after its stamp. */
  readonly isFrameLocked: boolean;
  readonly points: MarkerPoints;
  readonly text: string;
}

export type MarkerChange =
  | { readonly action: "set"; readonly marker: Marker }
  | { readonly action: "delete"; readonly key: string }
  | { readonly action: "delete_all" };

const DELETE = 2;
const DELETE_ALL = 3;
const FAR_M = 8_192;
const MAX_TEXT = 400;

/** Return the changes of a message; markers of unknown types, and without finite numbers, are left out. */
export function markerChanges(message: Value): readonly MarkerChange[] {
  const markers = part(message, "markers");
  const items = Array.isArray(markers) ? markers.slice(0, MAX_MARKERS) : [message];
  const budget = { points: MAX_MARKER_POINTS };
  return items.flatMap((item) => changeOf(item, budget) ?? []);
}

function changeOf(item: Value, budget: { points: number }): MarkerChange | null {
  const action = numberOf(part(item, "action"));
  const key = `${textOf(part(item, "ns"))}/${String(numberOf(part(item, "id")))}`;
  if (action === DELETE) return { action: "delete", key };
  if (action === DELETE_ALL) return { action: "delete_all" };
  const shape = MARKER_SHAPES[numberOf(part(item, "type"))];
  const pose = poseOf(part(item, "pose")) ?? (part(item, "pose") === null ? IDENTITY : null);
  const scale = vectorOf(part(item, "scale"));
  if (shape === undefined || pose === null || scale === null) return null;
  const lifetime = secondsOf(part(item, "lifetime"));
  const marker: Marker = {
    key,
    frame: frameOf(item),
    stampSeconds: stampOf(item),
    shape,
    pose,
    scale,
    colour: colourOf(part(item, "color")),
    lifetimeSeconds: lifetime > 0 ? lifetime : Infinity,
    isFrameLocked: part(item, "frame_locked") === true || part(item, "frame_locked") === 1,
    points: markerPoints(item, budget),
    text: textOf(part(item, "text")).slice(0, MAX_TEXT),
  };
  return { action: "set", marker };
}

function markerPoints(item: Value, budget: { points: number }): MarkerPoints {
  const points = listOf(part(item, "points"));
  const colours = listOf(part(item, "colors"));
  const count = Math.min(points.length, budget.points);
  budget.points -= count;
  const hasColours = colours.length > 0 && colours.length >= points.length;
  const positions = new Float32Array(3 * count);
  const rgba = hasColours ? new Float32Array(4 * count) : null;
  let origin: Vector = [0, 0, 0];
  let used = 0;
  for (let place = 0; place < count; place += 1) {
    const point = vectorOf(points[place] ?? null);
    if (point === null) continue;
    if (used === 0 && Math.max(...point.map(Math.abs)) > FAR_M) origin = point;
    positions.set([point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]], 3 * used);
    rgba?.set(colourOf(colours[place]  ?? null), 4 * used);
    used += 1;
  }
  return { positions: positions.slice(0, 3 * used), origin, colours: rgba?.slice(0, 4 * used) ?? null, totalPoints: points.length };
}

/** Return the buffers of changes, to be moved to the page. */
export function markerBuffers(changes: readonly MarkerChange[]): ArrayBuffer[] {
  return changes.flatMap((change) => {
    if (change.action !== "set") return [];
    const { positions, colours } = change.marker.points;
    return colours === null ? [positions.buffer] : [positions.buffer, colours.buffer];
  });
}

/** The markers of a topic after some messages. */
export class MarkerSet {
  private readonly markers = new Map<string, { readonly marker: Marker; readonly sinceSeconds: number }>();

  /** Apply the changes of a message that was logged at a time. Messages come in the order of their log times. */
  apply(changes: readonly MarkerChange[], logSeconds: number): void {
    for (const change of changes) {
      if (change.action === "delete_all") this.markers.clear();
      else if (change.action === "delete") this.markers.delete(change.key);
      else this.set(change.marker, logSeconds);
    }
  }

  /** Return the markers whose lifetimes include a time, the oldest first. */
  visibleAt(logSeconds: number): readonly Marker[] {
    const visible = [...this.markers.values()].filter(({ marker, sinceSeconds }) => logSeconds < sinceSeconds + marker.lifetimeSeconds);
    return visible.map(({ marker }) => marker);
  }

  clear(): void {
    this.markers.clear();
  }

  private set(marker: Marker, sinceSeconds: number): void {
    this.markers.delete(marker.key);
    this.markers.set(marker.key, { marker, sinceSeconds });
    if (this.markers.size <= MAX_MARKERS) return;
    for (const oldest of this.markers.keys()) {
      this.markers.delete(oldest);
      break;
    }
  }
}
