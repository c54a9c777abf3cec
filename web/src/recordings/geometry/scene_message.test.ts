import { describe, expect, it } from "vitest";
import type { Value } from "../decoding/decoder";
import { MAX_MARKERS } from "../limits";
import { markerChanges, MarkerSet } from "./markers";
import { isSceneType, sceneBuffers, sceneMessage } from "./scene_message";

const POSE = { position: { x: 1, y: 2, z: 3 }, orientation: { x: 0, y: 0, z: 0, w: 1 } };
const HEADER = { frame_id: "/map", stamp: 12.5 };

function marker(more: Record<string, Value> = {}): Value {
  return { header: HEADER, ns: "boxes", id: 1, type: 1, action: 0, pose: POSE, scale: { x: 1, y: 1, z: 2 }, color: { r: 1, g: 0.5, b: 0, a: 2 }, lifetime: 0, points: [], colors: [], text: "", ...more };
}

describe("sceneMessage", () => {
  it("knows the types of ROS 1, ROS 2 and Foxglove", () => {
    const types = ["sensor_msgs/PointCloud2", "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "visualization_msgs/MarkerArray", "foxglove.PointCloud", "foxglove_msgs/msg/PointCloud"];
    expect(types.map(isSceneType)).toEqual(types.map(() => true));
    expect(["sensor_msgs/Imu", "constructor", "my_msgs/Path", null].map(isSceneType)).toEqual([false, false, false, false]);
    expect(() => sceneMessage("constructor", {})).toThrow("not_spatial");
  });

  it("reads poses of odometry, paths and arrays", () => {
    const odometry = sceneMessage("nav_msgs/Odometry", { header: HEADER, child_frame_id: "base", pose: { pose: POSE, covariance: [] }, twist: {} });
    expect(odometry).toMatchObject({ frame: "map", stampSeconds: 12.5, content: { kind: "poses", sequence: { isPath: false, poses: [{ position: [1, 2, 3] }] } } });
    const stamped = sceneMessage("geometry_msgs/msg/PoseStamped", { header: HEADER, pose: POSE });
    expect(stamped.content).toEqual(odometry.content);
    const path = sceneMessage("nav_msgs/Path", { header: HEADER, poses: [{ header: HEADER, pose: POSE }, { pose: { ...POSE, position: { x: NaN, y: 0, z: 0 } } }] });
    expect(path.content).toMatchObject({ sequence: { isPath: true, poses: [{ position: [1, 2, 3] }], invalidPoses: 1 } });
    const list = sceneMessage("geometry_msgs/PoseArray", { header: HEADER, poses: [POSE, POSE] });
    expect(list.content).toMatchObject({ sequence: { isPath: false, poses: { length: 2 } } });
    expect(() => sceneMessage("nav_msgs/Odometry", { header: HEADER })).toThrow("pose_unreadable");
  });

  it("reads grids with unknown cells, and refuses those that cannot be", () => {
    const info = { resolution: 0.5, width: 3, height: 2, origin: POSE };
    const grid = sceneMessage("nav_msgs/msg/OccupancyGrid", { header: HEADER, info, data: Int8Array.of(0, 50, 100, -1, 101, 7) });
    expect(grid.content).toMatchObject({ grid: { width: 3, height: 2, cellM: 0.5, cells: Uint8Array.of(0, 50, 100, 255, 255, 7), origin: { position: [1, 2, 3] } } });
    expect(sceneBuffers(grid)).toHaveLength(1);
    const bad = (more: Record<string, Value>) => () => sceneMessage("nav_msgs/OccupancyGrid", { header: HEADER, info: { ...info, ...more }, data: Int8Array.of(1, 2, 3, 4, 5, 6) });
    expect(bad({ width: 0 })).toThrow("grid_unreadable: 0 × 2 cells");
    expect(bad({ width: 1_000_000, height: 1_000_000 })).toThrow("grid_unreadable: 6 bytes");
    expect(bad({ resolution: NaN })).toThrow("grid_unreadable");
  });

  it("draws every n-th cell of a large grid", () => {
    const info = { resolution: 0.1, width: 4_096, height: 4, origin: POSE };
    const { content } = sceneMessage("nav_msgs/OccupancyGrid", { header: HEADER, info, data: new Int8Array(4_096 * 4).fill(9) });
    expect(content).toMatchObject({ grid: { width: 2_048, height: 2, cellM: 0.2, totalCells: 16_384 } });
  });
});

describe("markers", () => {
  it("reads a marker with its points and colours", () => {
    const points = [{ x: 0, y: 0, z: 0 }, { x: NaN, y: 0, z: 0 }, { x: 1, y: 2, z: 3 }];
    const colors = [{ r: 1, g: 0, b: 0, a: 1 }, { r: 0, g: 0, b: 0, a: 1 }, { r: 0, g: 0, b: 1, a: 0.5 }];
    const [change] = markerChanges(marker({ type: 4, points, colors }));
    expect(change).toMatchObject({ action: "set", marker: { key: "boxes/1", frame: "map", shape: "line_strip", scale: [1, 1, 2], colour: [1, 0.5, 0, 1], lifetimeSeconds: Infinity } });
    if (change?.action !== "set") throw new Error("no marker");
    expect([...change.marker.points.positions]).toEqual([0, 0, 0, 1, 2, 3]);
    expect([...(change.marker.points.colours ?? [])]).toEqual([1, 0, 0, 1, 0, 0, 1, 0.5]);
    expect(change.marker.points.totalPoints).toBe(3);
  });

  it("adds, replaces, deletes and forgets after the lifetime", () => {
    const set = new MarkerSet();
    const keys = (seconds: number): string[] => set.visibleAt(seconds).map(({ key }) => key);
    set.apply(markerChanges({ markers: [marker(), marker({ id: 2, lifetime: { sec: 1, nanosec: 500_000_000 } })] }), 10);
    expect([keys(11), keys(11.6)]).toEqual([["boxes/1", "boxes/2"], ["boxes/1"]]);
    set.apply(markerChanges(marker({ type: 2 })), 12);
    expect(set.visibleAt(12).map(({ shape }) => shape)).toEqual(["sphere"]);
    set.apply(markerChanges(marker({ action: 2 })), 13);
    expect(keys(13)).toEqual([]);
    set.apply(markerChanges({ markers: [marker(), marker({ id: 7, action: 3 }), marker({ id: 8 })] }), 14);
    expect(keys(14)).toEqual(["boxes/8"]);
  });

  it("leaves out what cannot be drawn, and bounds the set", () => {
    expect(markerChanges({ markers: [null, marker({ type: 99 }), marker({ scale: { x: NaN, y: 1, z: 1 } }), marker({ pose: { position: {} } })] })).toEqual([]);
    const set = new MarkerSet();
    for (let id = 0; id < MAX_MARKERS + 5; id += 1) set.apply(markerChanges(marker({ id })), 1);
    const visible = set.visibleAt(1);
    expect([visible.length, visible[0]?.key]).toEqual([MAX_MARKERS, "boxes/5"]);
  });
});
