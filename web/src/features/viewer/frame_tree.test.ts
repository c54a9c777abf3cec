import { describe, expect, it, vi } from "vitest";
import { edgesAt, frameRows, relativePose, rollPitchYaw, type TransformMessage } from "./frame_tree";
import type { Quaternion } from "@/recordings/geometry/poses";

const IDENTITY: Quaternion = [0, 0, 0, 1];

function message(timeNs: number, pairs: readonly (readonly [parent: string, child: string, x: number])[], isStatic = false): TransformMessage {
  const transforms = pairs.map(([parent, child, x]) => ({ parent, child, stampSeconds: null, pose: { position: [x, 0, 0] as const, orientation: IDENTITY } }));
  return { timeNs: BigInt(timeNs), isStatic, transforms };
}

const ROBOT = [message(50, [["base", "camera", 0.5]], true), message(10, [["map", "odom", 1], ["odom", "base", 2]]), message(20, [["odom", "base", 3]]), message(30, [["odom", "base", 4]])];

describe("the tree of frames", () => {
  it("has the latest transforms at a time, and static ones at all times", () => {
    const edges = edgesAt(ROBOT, 25n);
    expect(frameRows(edges).map(({ frame, depth, edge }) => [frame, depth, edge?.timeNs, edge?.isStatic])).toEqual([
      ["map", 0, undefined, undefined],
      ["odom", 1, 10n, false],
      ["base", 2, 20n, false],
      ["camera", 3, 50n, true],
    ]);
    expect(frameRows(edgesAt(ROBOT, 5n)).map(({ frame }) => frame)).toEqual(["base", "camera"]);
  });

  it("gives the pose of a frame relative to another", () => {
    const edges = edgesAt(ROBOT, 25n);
    expect(relativePose(edges, "map", "camera")).toMatchObject({ position: [4.5, 0, 0] });
    expect(relativePose(edges, "camera", "map")).toMatchObject({ position: [-4.5, 0, 0] });
    expect(relativePose(edges, "map", "arm")).toEqual({ reason: "frame_unknown", frame: "arm" });
  });

  it("names several trees, several parents and loops", () => {
    const edges = edgesAt([message(1, [["map", "base", 1], ["world", "moon", 1]]), message(2, [["odom", "base", 1]]), message(3, [["a", "b", 1], ["b", "c", 1], ["c", "a", 1], ["a", "tool", 1]])], 9n);
    const rows = new Map(frameRows(edges).map((row) => [row.frame, row]));
    expect(rows.get("base")?.otherParents).toEqual(["map"]);
    expect(rows.get("base")?.edge?.transform.parent).toBe("odom");
    expect([...rows.values()].filter(({ isInLoop }) => isInLoop).map(({ frame, depth }) => [frame, depth])).toEqual([["a", 0], ["b", 1], ["c", 2]]);
    expect(rows.get("tool")?.depth).toBe(1);
    expect(relativePose(edges, "world", "base")).toMatchObject({ reason: "not_connected" });
    expect(relativePose(edges, "a", "c")).toMatchObject({ reason: "loop" });
  });

  it("writes no text for each transform: the tree is made for each frame of the picture", () => {
    const written = vi.spyOn(JSON, "stringify");
    expect(edgesAt([message(1, [["a", "b c", 0], ["a b", "c", 0], ["a", "b c", 1]])], 1n)).toHaveLength(2);
    expect(written).not.toHaveBeenCalled();
  });

  it("is bounded, and deep trees do not exhaust the stack", () => {
    const chain = Array.from({ length: 20_000 }, (_, number) => [`f${number}`, `f${number + 1}`, 0] as const);
    expect(frameRows(edgesAt([message(1, chain)], 1n))).toHaveLength(5_001);
  });
});

describe("roll, pitch and yaw", () => {
  it("are turns about fixed axes in degrees", () => {
    const half = Math.SQRT1_2;
    expect(rollPitchYaw([half, 0, 0, half]).map(Math.round)).toEqual([90, 0, 0]);
    expect(rollPitchYaw([0, 0, half, half]).map(Math.round)).toEqual([0, 0, 90]);
    // scipy: Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_quat()
    const angles = rollPitchYaw([0.0381346, 0.1893079, 0.2392983, 0.9515485]);
    [10, 20, 30].forEach((angle, place) => expect(angles[place]).toBeCloseTo(angle, 3));
  });

  it("put the whole turn into yaw where the pitch is a quarter turn", () => {
    const half = Math.SQRT1_2;
    const [roll, pitch, yaw] = rollPitchYaw([0, half, 0, half]);
    expect([roll, pitch, Math.round(yaw)]).toEqual([0, 90, -0]);
  });
});
