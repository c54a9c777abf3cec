/** The transforms between frames over time. Bounded: frames, and samples of each frame.
 *
 * Source: tf2 and REP 105 (frames form a tree; each has one parent). The values are those of `klein trajectory` and
 * `recordings/trajectories/transforms.py` of the SDK.
 */

import { MAX_FRAMES, MAX_TRANSFORM_SAMPLES } from "../limits";
import { between, followedBy, IDENTITY, inverse, type Pose } from "./poses";
import type { Transform } from "./transforms";

/** Why two frames have no transform: `frame` is unknown, not in the same tree, or its own ancestor. */
export interface MissingTransform {
  readonly reason: "frame_unknown" | "not_connected" | "loop";
  readonly frame: string;
}

export interface FoundTransform {
  readonly pose: Pose;
  /** Whether a transform on the way has no sample on both sides of the time, so that its nearest one is used. */
  readonly isExtrapolated: boolean;
}

/** Samples of a frame in its parent, by ascending stamps in seconds. */
interface Samples {
  parent: string;
  isStatic: boolean;
  readonly stamps: number[];
  readonly poses: Pose[];
}

export class TransformBuffer {
  private readonly byChild = new Map<string, Samples>();
  private readonly names = new Set<string>();

  /** The frames, in the order of their names. */
  get frames(): readonly string[] {
    return [...this.names].toSorted();
  }

  parentOf(frame: string): string | null {
    return this.byChild.get(frame)?.parent ?? null;
  }

  /** Add a transform; `logSeconds` is its time where it has no stamp. Of a static one, the last replaces the others. */
  add({ parent, child, pose, stampSeconds }: Transform, isStatic: boolean, logSeconds: number): void {
    const known = this.byChild.get(child);
    if (known === undefined && this.byChild.size >= MAX_FRAMES) return;
    const replaces = known === undefined || known.parent !== parent || isStatic || known.isStatic;
    const samples = replaces ? { parent, isStatic, stamps: [], poses: [] } : known;
    this.byChild.set(child, samples);
    this.names.add(parent).add(child);
    if (this.names.size > 2 * MAX_FRAMES) this.collectNames();
    insert(samples, stampSeconds ?? logSeconds, pose);
  }

  /** Forget the samples that are not static. */
  clearDynamic(): void {
    for (const [child, { isStatic }] of this.byChild) if (!isStatic) this.byChild.delete(child);
    this.collectNames();
  }

  /** Forget the parents that frames no longer have. */
  private collectNames(): void {
    this.names.clear();
    for (const [child, { parent }] of this.byChild) this.names.add(parent).add(child);
  }

  /** Return the frame without a parent that a frame is below; the frame itself where it has none, or is in a loop. */
  rootOf(frame: string): string {
    const { frames, isLoop } = this.ancestors(frame);
    return isLoop ? frame : (frames.at(-1) ?? frame);
  }

  /** Return the pose of `child` in `parent` at a time. */
  find(parent: string, child: string, atSeconds: number): FoundTransform | MissingTransform {
    if (parent === child) return { pose: IDENTITY, isExtrapolated: false };
    for (const frame of [parent, child]) if (!this.names.has(frame)) return { reason: "frame_unknown", frame };
    const [up, down] = [this.ancestors(parent), this.ancestors(child)];
    if (up.isLoop || down.isLoop) return { reason: "loop", frame: up.isLoop ? parent : child };
    const parents = new Set(up.frames);
    const common = down.frames.find((frame) => parents.has(frame));
    if (common === undefined) return { reason: "not_connected", frame: child };
    const ofParent = this.poseIn(common, up.frames, atSeconds);
    const ofChild = this.poseIn(common, down.frames, atSeconds);
    return { pose: followedBy(inverse(ofParent.pose), ofChild.pose), isExtrapolated: ofParent.isExtrapolated || ofChild.isExtrapolated };
  }

  /** The frame and its ancestors, up to the root or to where they repeat. */
  private ancestors(frame: string): { frames: readonly string[]; isLoop: boolean } {
    const passed = new Set([frame]);
    for (let next = this.parentOf(frame); next !== null; next = this.parentOf(next)) {
      if (passed.has(next)) return { frames: [...passed], isLoop: true };
      passed.add(next);
    }
    return { frames: [...passed], isLoop: false };
  }

  private poseIn(common: string, frames: readonly string[], atSeconds: number): FoundTransform {
    let pose = IDENTITY;
    let isExtrapolated = false;
    for (const frame of frames.slice(0, frames.indexOf(common))) {
      const samples = this.byChild.get(frame);
      if (samples === undefined) continue;
      const step = sampleAt(samples, atSeconds);
      pose = followedBy(step.pose, pose);
      isExtrapolated ||= step.isExtrapolated;
    }
    return { pose, isExtrapolated };
  }
}

/** Insert a sample in order of its stamp; one with the same stamp is replaced, and the oldest is dropped at the limit. */
function insert({ stamps, poses }: Samples, stamp: number, pose: Pose): void {
  const place = firstAfter(stamps, stamp);
  if (place > 0 && stamps[place - 1] === stamp) {
    poses[place - 1] = pose;
    return;
  }
  stamps.splice(place, 0, stamp);
  poses.splice(place, 0, pose);
  if (stamps.length <= MAX_TRANSFORM_SAMPLES) return;
  stamps.shift();
  poses.shift();
}

/** Return the place of the first stamp after a time. */
function firstAfter(stamps: readonly number[], seconds: number): number {
  let [low, high] = [0, stamps.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((stamps[middle] ?? Infinity) <= seconds) low = middle + 1;
    else high = middle;
  }
  return low;
}

function sampleAt({ stamps, poses, isStatic }: Samples, seconds: number): FoundTransform {
  const after = firstAfter(stamps, seconds);
  const [before, next] = [poses[after - 1], poses[after]];
  const [from, to] = [stamps[after - 1] ?? 0, stamps[after] ?? 0];
  if (before !== undefined && next !== undefined) return { pose: between(before, next, (seconds - from) / (to - from)), isExtrapolated: false };
  return { pose: before ?? next ?? IDENTITY, isExtrapolated: !isStatic && from !== seconds };
}
