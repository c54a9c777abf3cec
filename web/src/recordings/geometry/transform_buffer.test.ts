import { describe, expect, it } from "vitest";
import type { Value } from "../decoding/decoder";
import turtles from "../testing/turtle_transforms.json";
import { MAX_TRANSFORM_SAMPLES } from "../limits";
import { between, followedBy, inverse, type Pose } from "./poses";
import { TransformBuffer, type MissingTransform, type FoundTransform } from "./transform_buffer";
import { isStaticTopic, isTransformType, transformsOf, type Transform } from "./transforms";

function posed(values: readonly number[]): Pose {
  const [x = 0, y = 0, z = 0, qx = 0, qy = 0, qz = 0, qw = 1] = values;
  return { position: [x, y, z], orientation: [qx, qy, qz, qw] };
}

function shifted(parent: string, child: string, stampSeconds: number | null, x: number): Transform {
  return { parent, child, stampSeconds, pose: posed([x, 0, 0, 0, 0, 0, 1]) };
}

function poseAt(result: FoundTransform | MissingTransform): Pose {
  if (!("pose" in result)) throw new Error(result.reason);
  return result.pose;
}

function expectClose(pose: Pose, values: readonly number[]): void {
  const { position, orientation } = pose;
  const sign = orientation[3] * (values[6] ?? 1) + orientation[2] * (values[5] ?? 0) < 0 ? -1 : 1; // q and −q are the same rotation
  [...position, ...orientation.map((part) => sign * part)].forEach((value, place) => expect(value).toBeCloseTo(values[place] ?? NaN, 5));
}

describe("TransformBuffer", () => {
  it("agrees with the SDK on a real recording", () => {
    const buffer = new TransformBuffer();
    for (const { isStatic, values, ...transform } of turtles.transforms) buffer.add({ ...transform, pose: posed(values) }, isStatic, 0);
    expect(turtles.poses.length).toBeGreaterThan(20);
    for (const { stampSeconds, values } of turtles.poses) expectClose(poseAt(buffer.find("turtle2", "carrot", stampSeconds)), values);
    for (const { stampSeconds, values } of turtles.poses) expectClose(inverse(poseAt(buffer.find("carrot", "turtle2", stampSeconds))), values);
  });

  it("interpolates positions linearly and rotations on the shorter way", () => {
    const quarter = { position: [2, 0, 0], orientation: [0, 0, -Math.SQRT1_2, -Math.SQRT1_2] } as const;
    const pose = between(posed([0, 0, 0, 0, 0, 0, 1]), quarter, 1 / 3);
    expect(pose.position[0]).toBeCloseTo(2 / 3, 12);
    expect(pose.orientation[2]).toBeCloseTo(Math.sin(Math.PI / 12), 12);
    expect(pose.orientation[3]).toBeCloseTo(Math.cos(Math.PI / 12), 12);
  });

  it("chains poses through turned frames", () => {
    const turned = posed([1, 0, 0, 0, 0, Math.SQRT1_2, Math.SQRT1_2]);
    const { position } = followedBy(turned, posed([2, 0, 0, 0, 0, 0, 1]));
    [1, 2, 0].forEach((value, axis) => expect(position[axis]).toBeCloseTo(value, 12));
  });

  it("uses the nearest sample outside of the samples and says so", () => {
    const buffer = new TransformBuffer();
    for (const [stamp, x] of [[20, 2], [10, 1]] as const) buffer.add(shifted("map", "base", stamp, x), false, 0);
    expect(buffer.find("map", "base", 15)).toMatchObject({ pose: { position: [1.5, 0, 0] }, isExtrapolated: false });
    expect(buffer.find("map", "base", 20)).toMatchObject({ pose: { position: [2, 0, 0] }, isExtrapolated: false });
    expect(buffer.find("map", "base", 5)).toMatchObject({ pose: { position: [1, 0, 0] }, isExtrapolated: true });
    expect(buffer.find("map", "base", 25)).toMatchObject({ pose: { position: [2, 0, 0] }, isExtrapolated: true });
  });

  it("takes static transforms at all times, the last one", () => {
    const buffer = new TransformBuffer();
    buffer.add(shifted("base", "lidar", 100, 1), true, 0);
    buffer.add(shifted("base", "lidar", 50, 3), true, 1);
    expect(buffer.find("base", "lidar", 7)).toMatchObject({ pose: { position: [3, 0, 0] }, isExtrapolated: false });
    buffer.add(shifted("map", "base", null, 5), false, 8);
    buffer.clearDynamic();
    expect(buffer.frames).toEqual(["base", "lidar"]);
  });

  it("names unknown and separate frames", () => {
    const buffer = new TransformBuffer();
    buffer.add(shifted("map", "base", 1, 1), false, 0);
    buffer.add(shifted("other", "camera", 1, 1), false, 0);
    expect(buffer.find("map", "gone", 1)).toEqual({ reason: "frame_unknown", frame: "gone" });
    expect(buffer.find("map", "camera", 1)).toEqual({ reason: "not_connected", frame: "camera" });
    expect([buffer.rootOf("camera"), buffer.rootOf("gone")]).toEqual(["other", "gone"]);
    expect(buffer.find("gone", "gone", 1)).toMatchObject({ pose: { position: [0, 0, 0] } });
  });

  it("names loops and ends", () => {
    const buffer = new TransformBuffer();
    for (const [parent, child] of [["a", "b"], ["b", "c"], ["c", "a"], ["c", "d"]] as const) buffer.add(shifted(parent, child, 1, 1), false, 0);
    expect(buffer.find("d", "b", 1)).toEqual({ reason: "loop", frame: "d" });
    expect(buffer.rootOf("d")).toBe("d");
  });

  it("follows a frame to its new parent", () => {
    const buffer = new TransformBuffer();
    buffer.add(shifted("map", "base", 1, 1), false, 0);
    buffer.add(shifted("odom", "base", 2, 7), false, 0);
    expect(buffer.find("map", "base", 2)).toMatchObject({ reason: "not_connected" });
    expect(poseAt(buffer.find("odom", "base", 1)).position).toEqual([7, 0, 0]);
  });

  it("keeps a bounded number of samples, the latest", () => {
    const buffer = new TransformBuffer();
    for (let stamp = 1; stamp <= MAX_TRANSFORM_SAMPLES + 10; stamp += 1) buffer.add(shifted("map", "base", stamp, stamp), false, 0);
    expect(poseAt(buffer.find("map", "base", 1)).position[0]).toBe(11);
    for (let number = 0; number < 30_000; number += 1) buffer.add(shifted(`parent${number}`, "base", 1, 1), false, 0);
    expect(buffer.frames.length).toBeLessThanOrEqual(10_001);
  });
});

describe("transformsOf", () => {
  const transform = { translation: { x: 1, y: 2, z: 3 }, rotation: { x: 0, y: 0, z: 0, w: 2 } };

  it("reads TFMessage and FrameTransform, without a leading slash", () => {
    const pose = { position: [1, 2, 3], orientation: [0, 0, 0, 1] };
    const message = { transforms: [{ header: { frame_id: "/map", stamp: 5.5 }, child_frame_id: "/base", transform }] };
    expect(transformsOf(message)).toEqual([{ parent: "map", child: "base", stampSeconds: 5.5, pose }]);
    const single = { timestamp: { seconds: 5, nanos: 500_000_000 }, parent_frame_id: "map", child_frame_id: "base", ...transform };
    expect(transformsOf(single)).toEqual([{ parent: "map", child: "base", stampSeconds: 5.5, pose }]);
  });

  it("leaves out what is no transform", () => {
    const broken = { ...transform, translation: { x: NaN, y: 0, z: 0 } };
    const items: Value[] = [null, {}, { header: { frame_id: "map" }, child_frame_id: "base", transform: broken }, { header: { frame_id: "a" }, child_frame_id: "a", transform }];
    expect(transformsOf({ transforms: items })).toEqual([]);
    expect(transformsOf("text")).toEqual([]);
  });

  it("knows types and static topics", () => {
    expect(["tf/tfMessage", "tf2_msgs/msg/TFMessage", "foxglove.FrameTransform", "foxglove.FrameTransforms"].map(isTransformType)).toEqual([true, true, true, true]);
    expect(["sensor_msgs/Imu", null].map(isTransformType)).toEqual([false, false]);
    expect(["/tf_static", "/robot/tf_static", "/tf", "/my_tf_static"].map(isStaticTopic)).toEqual([true, true, false, false]);
  });
});
