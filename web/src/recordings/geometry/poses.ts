/** Poses in double precision: translations in metres, rotations as unit quaternions.
 *
 * Source: B. Siciliano et al., "Robotics: Modelling, Planning and Control", section 2.6; K. Shoemake, "Animating
 * Rotation with Quaternion Curves", 1985 (slerp). The same as `recordings/trajectories/model.py` of the SDK.
 */

export type Vector = readonly [x: number, y: number, z: number];
export type Quaternion = readonly [x: number, y: number, z: number, w: number];

/** The pose of a child frame in its parent frame. */
export interface Pose {
  readonly position: Vector;
  readonly orientation: Quaternion;
}

export const IDENTITY: Pose = { position: [0, 0, 0], orientation: [0, 0, 0, 1] };
/** Below this angle, a linear interpolation of rotations is exact in double precision. */
const STRAIGHT_RAD = 1e-7;

/** Return a vector turned by a rotation. */
export function rotated([x, y, z, w]: Quaternion, [vx, vy, vz]: Vector): Vector {
  const tx = 2 * (y * vz - z * vy);
  const ty = 2 * (z * vx - x * vz);
  const tz = 2 * (x * vy - y * vx);
  return [vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx];
}

/** Return the rotation that turns by `other` first, then by the first one. */
export function product([ax, ay, az, aw]: Quaternion, [bx, by, bz, bw]: Quaternion): Quaternion {
  return [
    aw * bx + bw * ax + ay * bz - az * by,
    aw * by + bw * ay + az * bx - ax * bz,
    aw * bz + bw * az + ax * by - ay * bx,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/** Return the pose of `next`'s child frame, where `next` is in the child frame of `first`. */
export function followedBy(first: Pose, next: Pose): Pose {
  const [x, y, z] = rotated(first.orientation, next.position);
  const [px, py, pz] = first.position;
  return { position: [px + x, py + y, pz + z], orientation: product(first.orientation, next.orientation) };
}

/** Return the pose of the parent frame in the child frame. */
export function inverse({ position, orientation: [x, y, z, w] }: Pose): Pose {
  const conjugate: Quaternion = [-x, -y, -z, w];
  const [px, py, pz] = rotated(conjugate, position);
  return { position: [-px, -py, -pz], orientation: conjugate };
}

/** Return the pose between two: positions linear, rotations by slerp on the shorter way. `share` is from 0 to 1. */
export function between(first: Pose, next: Pose, share: number): Pose {
  const [ax, ay, az] = first.position;
  const [bx, by, bz] = next.position;
  const position: Vector = [ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az)];
  return { position, orientation: slerp(first.orientation, next.orientation, share) };
}

function slerp(first: Quaternion, next: Quaternion, share: number): Quaternion {
  const [ax, ay, az, aw] = first;
  const [bx, by, bz, bw] = next;
  const cosine = ax * bx + ay * by + az * bz + aw * bw;
  const sign = cosine < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(1, Math.abs(cosine)));
  const isStraight = angle < STRAIGHT_RAD;
  const sine = isStraight ? 1 : Math.sin(angle);
  const one = isStraight ? 1 - share : Math.sin((1 - share) * angle) / sine;
  const other = sign * (isStraight ? share : Math.sin(share * angle) / sine);
  return unit([one * ax + other * bx, one * ay + other * by, one * az + other * bz, one * aw + other * bw]) ?? first;
}

/** Return a quaternion with the length 1; null where it has none that is a number above zero. */
export function unit([x, y, z, w]: Quaternion): Quaternion | null {
  const length = Math.hypot(x, y, z, w);
  return Number.isFinite(length) && length > 0 ? [x / length, y / length, z / length, w / length] : null;
}
