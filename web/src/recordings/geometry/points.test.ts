import { describe, expect, it } from "vitest";
import type { Value } from "../decoding/decoder";
import { MAX_POINTS } from "../limits";
import { laserScan } from "./laser_scan";
import { foxglovePointCloud, pointCloud2 } from "./point_cloud";

type Field = Record<"offset" | "datatype", number> & { name: string };

const [INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64] = [1, 2, 3, 4, 5, 6, 7, 8] as const;
const XYZ: Field[] = [{ name: "x", offset: 0, datatype: FLOAT32 }, { name: "y", offset: 4, datatype: FLOAT32 }, { name: "z", offset: 8, datatype: FLOAT32 }];

function field(name: string, offset: number, datatype: number): Field {
  return { name, offset, datatype };
}

/** A message whose data `write` fills. */
function cloud(fields: Field[], pointStep: number, width: number, write: (view: DataView) => void, more: Record<string, number | boolean> = {}): Record<string, Value> & { data: Uint8Array } {
  const height = Number(more.height ?? 1);
  const data = new Uint8Array(Number(more.row_step ?? width * pointStep) * height);
  write(new DataView(data.buffer));
  return { header: { frame_id: "lidar" }, fields, point_step: pointStep, row_step: width * pointStep, width, height: 1, is_bigendian: false, data, ...more };
}

function floats(values: number[]) {
  return (view: DataView) => values.forEach((value, place) => view.setFloat32(4 * place, value, true));
}

describe("pointCloud2", () => {
  it("reads positions, bounds and the channel of a field, with padding between them", () => {
    const message = cloud([...XYZ, field("intensity", 16, FLOAT32)], 32, 2, (view) => {
      [1, 2, 3, 0, 7.5].forEach((value, place) => view.setFloat32(4 * place, value, true));
      [-4, 5, -6, 0, 2.5].forEach((value, place) => view.setFloat32(32 + 4 * place, value, true));
    });
    const points = pointCloud2(message);
    expect([...points.positions]).toEqual([1, 2, 3, -4, 5, -6]);
    expect(points.bounds).toEqual([[-4, 2, -6], [1, 5, 3]]);
    expect(points.channels.map(({ name, values, range }) => [name, [...values], range])).toEqual([["intensity", [7.5, 2.5], [2.5, 7.5]]]);
    expect([points.totalPoints, points.invalidPoints, points.missingPoints, points.colours]).toEqual([2, 0, 0, null]);
  });

  it.each([
    ["INT8", INT8, 1, -100], ["UINT8", UINT8, 1, 200], ["INT16", INT16, 2, -30_000], ["UINT16", UINT16, 2, 60_000],
    ["INT32", INT32, 4, -8_000_000], ["UINT32", UINT32, 4, 8_000_000], ["FLOAT32", FLOAT32, 4, 1.5], ["FLOAT64", FLOAT64, 8, -2.25],
  ])("reads %s in both byte orders at any offset", (_, datatype, bytes, value) => {
    const setters = { 1: "setInt8", 2: "setUint8", 3: "setInt16", 4: "setUint16", 5: "setInt32", 6: "setUint32", 7: "setFloat32", 8: "setFloat64" } as const;
    for (const isBigEndian of [false, true]) {
      const fields = [field("y", 3 + bytes, datatype), field("value", 3 + 2 * bytes, datatype), field("x", 3, datatype)];
      const message = cloud(fields, 3 + 3 * bytes, 1, (view) => {
        for (const at of [3, 3 + bytes, 3 + 2 * bytes]) view[setters[datatype]](at, value, !isBigEndian);
      }, { is_bigendian: isBigEndian });
      const { positions, origin, channels } = pointCloud2(message);
      expect([(positions[0] ?? 0) + origin[0], (positions[1] ?? 0) + origin[1], positions[2]]).toEqual([value, value, 0]);
      expect([...(channels[0]?.values ?? [])]).toEqual([value]);
    }
  });

  it("skips what fills up the rows of an organised cloud", () => {
    const message = cloud(XYZ, 12, 2, (view) => {
      [[0, 1], [12, 2], [32, 3], [44, 4]].forEach(([at = 0, value = 0]) => [0, 4, 8].forEach((axis) => view.setFloat32(at + axis, value, true)));
    }, { height: 2, row_step: 32 });
    expect([...pointCloud2(message).positions]).toEqual([1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
  });

  it("drops points without finite coordinates and counts them", () => {
    const points = pointCloud2(cloud(XYZ, 12, 4, floats([1, 2, 3, NaN, 0, 0, 0, Infinity, 0, 4, 5, 6])));
    expect([...points.positions]).toEqual([1, 2, 3, 4, 5, 6]);
    expect([points.totalPoints, points.invalidPoints]).toEqual([4, 2]);
    const none = pointCloud2(cloud(XYZ, 12, 1, floats([NaN, NaN, NaN])));
    expect([none.positions.length, none.bounds, none.invalidPoints]).toEqual([0, null, 1]);
  });

  it("keeps millimetres of coordinates of UTM, relative to the first point", () => {
    const fields = [field("x", 0, FLOAT64), field("y", 8, FLOAT64), field("z", 16, FLOAT64)];
    const message = cloud(fields, 24, 2, (view) => {
      [465_000.125, 5_247_000.25, 430.5, 465_000.126, 5_247_001.25, 431].forEach((value, place) => view.setFloat64(8 * place, value, true));
    });
    const { positions, origin, bounds } = pointCloud2(message);
    expect(origin).toEqual([465_000.125, 5_247_000.25, 430.5]);
    expect(positions[3]).toBeCloseTo(0.001, 6);
    expect([...positions.slice(4)]).toEqual([1, 0.5]);
    expect(bounds?.[1]).toEqual([465_000.126, 5_247_001.25, 431]);
  });

  it("reads packed colours, and no channel of them", () => {
    const message = cloud([...XYZ, field("rgb", 12, FLOAT32), field("ring", 16, UINT16)], 18, 1, (view) => {
      view.setUint32(12, 0x00_ff_80_01, true);
      view.setUint16(16, 31, true);
    });
    const { colours, channels } = pointCloud2(message);
    expect([colours?.name, ...(colours?.rgb ?? [])]).toEqual(["rgb", 0xff, 0x80, 0x01]);
    expect(channels.map(({ name, range }) => [name, range])).toEqual([["ring", [31, 31]]]);
  });

  it("reads at most four channels, the preferred ones first", () => {
    const names = ["a", "b", "c", "d", "ring", "intensity"];
    const message = cloud([...XYZ, ...names.map((name, place) => field(name, 12 + place, UINT8))], 18, 1, () => undefined);
    expect(pointCloud2(message).channels.map(({ name }) => name)).toEqual(["intensity", "ring", "a", "b"]);
  });

  it("draws every n-th point of a large cloud", () => {
    const width = 1_000_000;
    const message = cloud(XYZ, 12, width, (view) => {
      for (let place = 0; place < width; place += 1) view.setFloat32(12 * place, place % 4096, true);
    });
    const { positions, totalPoints } = pointCloud2(message);
    expect(totalPoints).toBe(width);
    expect(positions.length / 3).toBe(250_000);
    expect(positions.length / 3).toBeLessThanOrEqual(MAX_POINTS);
    expect([...positions.filter((_, place) => place % 3 === 0).slice(0, 3)]).toEqual([0, 4, 8]);
  });

  it("shows the points that a cut message has, and how many are missing", () => {
    const whole = cloud(XYZ, 12, 3, floats([1, 1, 1, 2, 2, 2, 3, 3, 3]));
    const points = pointCloud2({ ...whole, data: whole.data.subarray(0, 30) });
    expect([points.positions.length / 3, points.totalPoints, points.missingPoints]).toEqual([2, 3, 1]);
    expect(() => pointCloud2({ ...whole, data: whole.data.subarray(0, 11) })).toThrow("cloud_unreadable: 11 bytes for 3 points");
  });

  it("has no points where the message has none", () => {
    expect(pointCloud2(cloud(XYZ, 12, 0, () => undefined)).totalPoints).toBe(0);
    expect(pointCloud2(cloud([], 0, 0, () => undefined)).positions).toHaveLength(0);
  });

  it("refuses layouts that cannot be", () => {
    expect(() => pointCloud2({ x: 1 })).toThrow("cloud_unreadable: it has no data");
    expect(() => pointCloud2(cloud([field("x", 0, FLOAT32)], 4, 1, () => undefined))).toThrow("no fields x and y");
    expect(() => pointCloud2(cloud([field("x", 0, FLOAT32), field("y", 10, FLOAT32)], 12, 1, () => undefined))).toThrow("no fields x and y");
    expect(() => pointCloud2(cloud([field("x", 0, 99), field("y", 4, FLOAT32)], 12, 1, () => undefined))).toThrow("no fields x and y");
    expect(() => pointCloud2({ ...cloud(XYZ, 12, 2, () => undefined), row_step: 12 })).toThrow("rows of 12 bytes");
    expect(() => pointCloud2({ ...cloud(XYZ, 12, 2, () => undefined), width: 2 ** 32, height: 2 ** 32, row_step: 2 ** 50 })).toThrow("cloud_unreadable");
    const vast = { ...cloud(XYZ, 12, 2, floats([1, 2, 3, 4, 5, 6])), width: 2 ** 30, row_step: 0 };
    expect(pointCloud2(vast).positions).toHaveLength(6);
  });
});

describe("foxglovePointCloud", () => {
  it("reads packed fields in base64, with the pose of its origin", () => {
    const bytes = new Uint8Array(new Float32Array([1, 2, 3, 9]).buffer);
    const fields = ["x", "y", "z", "intensity"].map((name, place) => ({ name, offset: 4 * place, type: 7 }));
    const pose = { position: { x: 10, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 1, w: 1 } };
    const cloudMessage = { frame_id: "lidar", point_stride: 16, fields, pose, data: btoa(String.fromCharCode(...bytes)) };
    const { points, pose: origin } = foxglovePointCloud(cloudMessage);
    expect([...points.positions]).toEqual([1, 2, 3]);
    expect(points.channels[0]?.range).toEqual([9, 9]);
    expect(origin.position).toEqual([10, 0, 0]);
    expect(origin.orientation[2]).toBeCloseTo(Math.SQRT1_2, 12);
    expect(foxglovePointCloud({ ...cloudMessage, point_stride: 0 }).points.totalPoints).toBe(0);
  });
});

describe("laserScan", () => {
  const scan = { angle_min: -Math.PI / 2, angle_increment: Math.PI / 2, range_min: 0.1, range_max: 10, ranges: Float32Array.of(1, 2, 3), intensities: Float32Array.of(4, 5, 6) };

  it("places the ranges at their angles", () => {
    const { positions, channels } = laserScan(scan);
    [0, -1, 0, 2, 0, 0, 0, 3, 0].forEach((value, place) => expect(positions[place]).toBeCloseTo(value, 6));
    expect(channels.map(({ name, range }) => [name, range])).toEqual([["range", [1, 3]], ["intensity", [4, 6]]]);
  });

  it("drops ranges outside of the limits and without a number", () => {
    const points = laserScan({ ...scan, ranges: Float32Array.of(0.05, NaN, 11, Infinity, 5), intensities: [] });
    expect([points.totalPoints, points.invalidPoints, points.positions.length / 3]).toEqual([5, 4, 1]);
    expect(() => laserScan({ ...scan, angle_increment: NaN })).toThrow("cloud_unreadable");
  });
});
