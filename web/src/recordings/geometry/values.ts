/** Access to parts of decoded messages that may lack them or have other types. */

import { isFields, isNumbers, type Value } from "../decoding/decoder";
import { unit, type Pose, type Quaternion, type Vector } from "./poses";

/** Red, green, blue and alpha, from 0 to 1. */
export type Colour = readonly [red: number, green: number, blue: number, alpha: number];

/** Return a part of a message by the names of its fields; null where there is none. */
export function part(value: Value | undefined, ...names: readonly string[]): Value {
  let inner = value;
  for (const name of names) inner = isFields(inner) && Object.hasOwn(inner, name) ? inner[name] : undefined;
  return inner ?? null;
}

export function numberOf(value: Value | undefined): number {
  if (typeof value === "boolean") return value ? 1 : 0;
  return typeof value === "number" ? value : Number.NaN;
}

/** Return a whole number from 0 on; 0 for everything else. */
export function countOf(value: Value | undefined): number {
  const number = numberOf(value);
  return Number.isSafeInteger(number) && number > 0 ? number : 0;
}

export function textOf(value: Value | undefined): string {
  return typeof value === "string" ? value : "";
}

export function listOf(value: Value | undefined): readonly Value[] {
  return Array.isArray(value) ? value : [];
}

export function numbersOf(value: Value | undefined): ArrayLike<number> {
  if (isNumbers(value)) return value;
  return Array.isArray(value) ? value.map((item) => numberOf(item)) : [];
}

/** Return the bytes of a field: as such, as numbers, or in base64 (JSON). */
export function bytesOf(value: Value | undefined): Uint8Array | null {
  if (value instanceof Uint8Array) return value;
  if (isNumbers(value)) return new Uint8Array(value.buffer, value.byteOffset, value.byteLength);
  if (Array.isArray(value)) return Uint8Array.from(value, (item) => numberOf(item));
  if (typeof value !== "string") return null;
  try {
    return Uint8Array.from(atob(value), (letter) => letter.charCodeAt(0));
  } catch {
    return null;
  }
}

/** Return the frame of a message, without the slash that ROS 1 may put first. */
export function frameOf(message: Value): string {
  return frameName(part(message, "header", "frame_id") ?? part(message, "frame_id"));
}

export function frameName(value: Value | undefined): string {
  return textOf(value).replace(/^\/+/, "");
}

/** Return the stamp of a header in seconds; null where there is none, or only 0. */
export function stampOf(message: Value): number | null {
  const seconds = secondsOf(part(message, "header", "stamp") ?? part(message, "timestamp"));
  return seconds > 0 ? seconds : null;
}

/** Return a time or duration in seconds: decoded ROS times are numbers, those of JSON and protobuf have parts. */
export function secondsOf(value: Value): number {
  if (typeof value === "number") return value;
  const seconds = numberOf(part(value, "sec") ?? part(value, "secs") ?? part(value, "seconds"));
  const nanoseconds = numberOf(part(value, "nsec") ?? part(value, "nanosec") ?? part(value, "nsecs") ?? part(value, "nanos"));
  return seconds + (Number.isNaN(nanoseconds) ? 0 : nanoseconds * 1e-9);
}

/** Return a point or a vector; null where a coordinate is no finite number. */
export function vectorOf(value: Value): Vector | null {
  const vector: Vector = [numberOf(part(value, "x")), numberOf(part(value, "y")), numberOf(part(value, "z"))];
  return vector.every(Number.isFinite) ? vector : null;
}

/** Return a rotation with the length 1; null where it is none. Four zeros, which writers leave unset, turn nothing. */
export function quaternionOf(value: Value): Quaternion | null {
  const four = ["x", "y", "z", "w"].map((name) => numberOf(part(value, name))) as [number, number, number, number];
  return four.every((component) => component === 0) ? [0, 0, 0, 1] : unit(four);
}

/** Return the pose of a message with a position and an orientation; null where it has none that is usable. */
export function poseOf(value: Value, names: readonly [string, string] = ["position", "orientation"]): Pose | null {
  const position = vectorOf(part(value, names[0]));
  const orientation = quaternionOf(part(value, names[1]));
  return position === null || orientation === null ? null : { position, orientation };
}

export function colourOf(value: Value): Colour {
  const channel = (name: string): number => {
    const share = numberOf(part(value, name));
    return Number.isFinite(share) ? Math.min(1, Math.max(0, share)) : 0;
  };
  return [channel("r"), channel("g"), channel("b"), channel("a")];
}
