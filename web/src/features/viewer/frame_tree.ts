// The tree of frames at a time: the latest transform of each frame, frames with several parents, and loops.
import type { Pose, Quaternion } from "@/recordings/geometry/poses";
import { TransformBuffer, type MissingTransform } from "@/recordings/geometry/transform_buffer";
import type { Transform } from "@/recordings/geometry/transforms";

/** A message with transforms. */
export interface TransformMessage {
  readonly timeNs: bigint;
  readonly isStatic: boolean;
  readonly transforms: readonly Transform[];
}

/** The latest transform from a parent to a frame. */
export interface FrameEdge {
  readonly transform: Transform;
  readonly timeNs: bigint;
  readonly isStatic: boolean;
}

/** A row of the tree. */
export interface FrameRow {
  readonly frame: string;
  readonly depth: number;
  /** Null for a root. */
  readonly edge: FrameEdge | null;
  /** Parents that other transforms name. */
  readonly otherParents: readonly string[];
  /** Whether the frame is its own ancestor. */
  readonly isInLoop: boolean;
}

/** Edges of one time. */
export const MAX_EDGES = 5_000;

/** Returns the latest transform of each pair of frames at a time, in order of time. Static ones are valid at all times. */
export function edgesAt(messages: readonly TransformMessage[], timeNs: bigint): FrameEdge[] {
  const byParent = new Map<string, Map<string, FrameEdge>>();
  let count = 0;
  for (const { timeNs: ownNs, isStatic, transforms } of messages) {
    if (!isStatic && ownNs > timeNs) continue;
    for (const transform of transforms) {
      const edges = byParent.get(transform.parent) ?? new Map<string, FrameEdge>();
      const known = edges.get(transform.child);
      if (known === undefined ? count >= MAX_EDGES : known.timeNs > ownNs) continue;
      if (known === undefined) count += 1;
      byParent.set(transform.parent, edges.set(transform.child, { transform, timeNs: ownNs, isStatic }));
    }
  }
  return [...byParent.values()].flatMap((edges) => [...edges.values()]).toSorted((a, b) => (a.timeNs < b.timeNs ? -1 : 1));
}

/** Returns the rows of the tree from the roots on. A frame is below its latest parent; a loop begins at its first name. */
export function frameRows(edges: readonly FrameEdge[]): FrameRow[] {
  const byChild = new Map<string, FrameEdge[]>();
  for (const edge of edges) byChild.set(edge.transform.child, [...(byChild.get(edge.transform.child) ?? []), edge]);
  const children = new Map<string, string[]>();
  for (const [child, own] of byChild) {
    const parent = own.at(-1)?.transform.parent ?? "";
    children.set(parent, [...(children.get(parent) ?? []), child]);
  }
  const frames = [...new Set(edges.flatMap(({ transform }) => [transform.parent, transform.child]))].toSorted();
  const rows: FrameRow[] = [];
  const shown = new Set<string>();

  function visit(root: string, loop: readonly string[]): void {
    const members = new Set(loop);
    const waiting = [{ frame: root, depth: 0 }];
    for (let next = waiting.pop(); next !== undefined; next = waiting.pop()) {
      const { frame, depth } = next;
      if (shown.has(frame)) continue;
      shown.add(frame);
      const own = byChild.get(frame) ?? [];
      rows.push({ frame, depth, edge: own.at(-1) ?? null, otherParents: own.slice(0, -1).map(({ transform }) => transform.parent), isInLoop: members.has(frame) });
      for (const child of (children.get(frame) ?? []).toSorted().toReversed()) waiting.push({ frame: child, depth: depth + 1 });
    }
  }

  for (const frame of frames) if (!byChild.has(frame)) visit(frame, []);
  for (const frame of frames) {
    if (shown.has(frame)) continue; // no root leads to the others
    const loop = loopAbove(frame, byChild);
    visit(loop[0] ?? frame, loop);
  }
  return rows;
}

/** Returns the frames of the loop that is above a frame, in the order of their names. */
function loopAbove(frame: string, byChild: ReadonlyMap<string, readonly FrameEdge[]>): readonly string[] {
  const parentOf = (name: string): string => byChild.get(name)?.at(-1)?.transform.parent ?? name;
  const passed = new Set<string>();
  let inLoop = frame;
  for (; !passed.has(inLoop); inLoop = parentOf(inLoop)) passed.add(inLoop);
  const loop = [inLoop];
  for (let next = parentOf(inLoop); next !== inLoop; next = parentOf(next)) loop.push(next);
  return loop.toSorted();
}

/** Returns the pose of a frame relative to another one, from the latest transforms. */
export function relativePose(edges: readonly FrameEdge[], reference: string, frame: string): Pose | MissingTransform {
  const buffer = new TransformBuffer();
  for (const { transform, isStatic } of edges) buffer.add({ ...transform, stampSeconds: null }, isStatic, 0);
  const result = buffer.find(reference, frame, 0);
  return "pose" in result ? result.pose : result;
}

const DEGREES = 180 / Math.PI;

/** Returns roll, pitch and yaw in degrees: turns about the fixed axes x, y, z, in this order. Source: REP 103. */
export function rollPitchYaw([x, y, z, w]: Quaternion): readonly [roll: number, pitch: number, yaw: number] {
  const sine = Math.max(-1, Math.min(1, 2 * (w * y - z * x)));
  // Where the pitch is a quarter turn, roll and yaw turn about the same axis: all of it is the yaw's.
  if (Math.abs(sine) > 1 - 1e-12) return [0, Math.sign(sine) * 90, -Math.sign(sine) * 2 * Math.atan2(x, w) * DEGREES];
  return [
    Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) * DEGREES,
    Math.asin(sine) * DEGREES,
    Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) * DEGREES,
  ];
}
