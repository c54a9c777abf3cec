// The track of a topic: its positions over time, thinned so that it stays small.
import type { ReadPart } from "./useParts";
import { worldPoint, type LinePlace, type WorldPoint } from "@/components/map/map_view";
import type { Location, Position, Shape } from "@/recordings/products/location";
import type { ReadMessage } from "@/recordings/products/products";

export interface TrackPoint extends Position {
  readonly timeNs: bigint;
  /** Whether the track is broken before it: messages between had no position. */
  readonly isStart: boolean;
}

export interface Track {
  readonly points: readonly TrackPoint[];
  /** Messages with a position; every `stride`-th of them is a point. */
  readonly positions: number;
  readonly stride: number;
  /** Messages without a position. */
  readonly missing: number;
  /** Whether the latest message had no position. */
  readonly isBroken: boolean;
}

export const EMPTY_TRACK: Track = { points: [], positions: 0, stride: 1, missing: 0, isBroken: true };
export const MAX_TRACK_POINTS = 4_000;

/** Returns the track with further messages, which are later. */
export function withPositions(track: Track, messages: readonly ReadMessage<"position">[]): Track {
  const points = [...track.points];
  let { positions, missing, isBroken, stride } = track;
  for (const { logTimeNs, product } of messages) {
    const position = product?.position ?? null;
    if (position === null) {
      missing += 1;
      isBroken = true;
      continue;
    }
    if (positions % stride === 0 || isBroken) {
      points.push({ timeNs: logTimeNs, ...position, isStart: isBroken });
      isBroken = false;
    }
    positions += 1;
    if (points.length > MAX_TRACK_POINTS) {
      halve(points);
      stride *= 2;
    }
  }
  return { points, positions, missing, isBroken, stride };
}

/** Leaves out every second point; a break before one of them moves to the point behind it. */
function halve(points: TrackPoint[]): void {
  let isStart = false;
  const rest = points.flatMap((point, place) => {
    isStart ||= point.isStart;
    if (place % 2 === 1) return [];
    const remaining = { ...point, isStart };
    isStart = false;
    return [remaining];
  });
  points.splice(0, points.length, ...rest);
}

/** A point of a track on the map. */
export interface TrackPlace extends LinePlace {
  readonly timeNs: bigint;
}

/** Returns the points of the parts that were read, as lines that are broken where a part is missing. */
export function trackPlaces(parts: readonly ReadPart<Track>[], anchorX: number): TrackPlace[] {
  return parts.flatMap(({ fileId, fromNs, content: { points } }, number) => {
    const before = parts[number - 1];
    const isContinued = before !== undefined && before.fileId === fileId && before.toNs + 1n === fromNs && !before.content.isBroken;
    return points.map((point, place) => ({ ...worldPoint(point, anchorX), timeNs: point.timeNs, isStart: point.isStart && !(place === 0 && isContinued) }));
  });
}

/** A place of the mission, of no topic. */
export interface NamedPlace extends WorldPoint {
  readonly name: string;
}

/** The shapes that a topic has on the map at the play head. */
export interface MapShapes {
  readonly lines: readonly LinePlace[];
  readonly areas: readonly LinePlace[];
  readonly points: readonly WorldPoint[];
}

/** Returns the shapes of a location as places. */
export function mapShapes(location: Location | null, anchorX: number): MapShapes {
  const places = (kind: Shape["kind"]): LinePlace[] =>
    (location?.shapes ?? []).filter((shape) => shape.kind === kind).flatMap(({ positions }) => positions.map((position, at) => ({ ...worldPoint(position, anchorX), isStart: at === 0 })));
  return { lines: places("line"), areas: places("area"), points: places("point") };
}
