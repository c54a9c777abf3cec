import { describe, expect, it } from "vitest";
import { colourFieldOf, colourFields, sharesOf } from "./colour_fields";
import { colourTable, type ColourMap } from "./colour_maps";
import { fixedFrameOf, placed, type TopicContent } from "./placement";
import { sceneSettings, topicSettings, withOption, withoutTopic, withSceneOption } from "./settings";
import { defaultLayout, kindsFor } from "../panels";
import { panelOf, panelText, type Panel } from "../layout";
import type { Marker } from "@/recordings/geometry/markers";
import { pointSetOf, type PointSet } from "@/recordings/geometry/points";
import { IDENTITY, type Pose } from "@/recordings/geometry/poses";
import { TransformBuffer } from "@/recordings/geometry/transform_buffer";

const CLOUD = { recording: "04cf00a6", topic: "/lidar/points", fields: [] };
const SCAN = { recording: "04cf00a6", topic: "/scan", fields: [] };
const PANEL: Panel = { kind: "scene", isWide: false, series: [CLOUD, SCAN] };

function pointSet(values: readonly number[]): PointSet {
  const column = (value: (place: number) => number) => Float64Array.from(values, (_, place) => value(place));
  const channels = [{ name: "intensity", values: Float32Array.from(values) }];
  return pointSetOf({ x: column((place) => place), y: column((place) => -place), z: column(() => 0), channels, colours: null }, values.length);
}

function content(frame: string, stampSeconds: number | null, markers: readonly Marker[] = []): TopicContent {
  const scene = { frame, stampSeconds, content: { kind: "points", points: pointSet([1]), pose: IDENTITY } } as const;
  return { topic: "/points", messages: [{ logTimeNs: 20_000_000_000n, logSeconds: 20, scene }], markers, colourBy: null, isRough: false };
}

function at(x: number): Pose {
  return { position: [x, 0, 0], orientation: [0, 0, 0, 1] };
}

/** The frame `base` moves 1 m in each second; `lidar` is 0.5 m ahead of it. */
function driving(): TransformBuffer {
  const buffer = new TransformBuffer();
  for (const seconds of [10, 20, 30]) buffer.add({ parent: "map", child: "base", stampSeconds: seconds, pose: at(seconds) }, false, 0);
  buffer.add({ parent: "base", child: "lidar", stampSeconds: 0, pose: at(0.5) }, true, 0);
  return buffer;
}

describe("the panel", () => {
  it("shows one cloud at first, and is offered for other types", () => {
    const topic = (name: string, messageType: string) => ({ recording: "a", name, messageType, count: 10, firstNs: 0, density: [] });
    const shown = defaultLayout([topic("/scan", "sensor_msgs/LaserScan"), topic("/points", "sensor_msgs/msg/PointCloud2"), topic("/odom", "nav_msgs/Odometry")]);
    expect(shown.filter(({ kind }) => kind === "scene").map(({ series }) => series[0]?.topic)).toEqual(["/points"]);
    expect(kindsFor(topic("/odom", "nav_msgs/msg/Odometry")).map(({ kind }) => kind)).toContain("scene");
    expect(kindsFor(topic("/imu", "sensor_msgs/Imu")).map(({ kind }) => kind)).not.toContain("scene");
  });
});

describe("settings", () => {
  it("come back from the address", () => {
    const options = [["frame", "odom"], ["follow", "base,link"], ["size", "5"], ["decay", "10"], ["map", "viridis"], ["frames", ""]] as const;
    const panel = options.reduce<Panel>((changed, [name, value]) => withSceneOption(changed, name, value), PANEL);
    const read = panelOf(panelText(panel)) ?? PANEL;
    expect(sceneSettings(read)).toEqual({ frame: "odom", follow: "base,link", pointPx: 5, decaySeconds: 10, colourMap: "viridis", showsFrames: true });
    expect(sceneSettings(withSceneOption(read, "frame", null)).frame).toBeNull();
    expect(read.series[1]).toEqual(SCAN);
  });

  it("are the defaults where the address has others", () => {
    const fields = ["size=99", "decay=-1", "map=constructor", "x"];
    expect(sceneSettings({ series: [{ ...CLOUD, fields }] })).toEqual({ frame: null, follow: null, pointPx: 2, decaySeconds: 0, colourMap: "turbo", showsFrames: false });
    expect(sceneSettings({ series: [] }).frame).toBeNull();
  });

  it("hide and colour a topic", () => {
    expect(topicSettings(CLOUD)).toEqual({ isVisible: true, colourBy: null });
    const changed = withOption(withOption(CLOUD, "hidden", ""), "colour", "");
    expect(topicSettings(changed)).toEqual({ isVisible: false, colourBy: "" });
    expect(topicSettings(panelOf(panelText({ ...PANEL, series: [changed] }))?.series[0] ?? CLOUD)).toEqual({ isVisible: false, colourBy: "" });
  });

  it("stay when the first topic is removed", () => {
    const panel = withSceneOption(withSceneOption(PANEL, "frame", "map"), "decay", "5");
    const rest = withoutTopic(panel, 0);
    expect(rest.series.map(({ topic }) => topic)).toEqual(["/scan"]);
    expect(sceneSettings(rest)).toMatchObject({ frame: "map", decaySeconds: 5 });
    expect(withoutTopic(panel, 1).series).toEqual([panel.series[0]]);
  });
});

describe("placed", () => {
  it("uses the transform at the stamp of a message", () => {
    const { items, missing, isExtrapolated } = placed([content("lidar", 12.5)], "map", driving(), 0);
    expect(items.map(({ pose }) => pose.position)).toEqual([[13, 0, 0]]);
    expect([missing, isExtrapolated]).toEqual([[], false]);
  });

  it("uses the log time of a message without a stamp, and says where a transform is of another time", () => {
    expect(placed([content("base", null)], "map", driving(), 0).items[0]?.pose.position).toEqual([20, 0, 0]);
    expect(placed([content("base", 99)], "map", driving(), 0)).toMatchObject({ isExtrapolated: true, items: [{ pose: { position: [30, 0, 0] } }] });
  });

  it("names frames without transforms once", () => {
    const { items, missing } = placed([content("gone", 12), content("gone", 13), content("map", 13)], "map", driving(), 0);
    expect(items).toHaveLength(1);
    expect(missing).toEqual([{ reason: "frame_unknown", frame: "gone" }]);
  });

  it("moves markers that are locked to their frames", () => {
    const points = { positions: new Float32Array(), origin: [0, 0, 0], colours: null, totalPoints: 0 } as const;
    const marker: Marker = { key: "a/1", frame: "base", stampSeconds: 10, shape: "cube", pose: at(1), scale: [1, 1, 1], colour: [1, 1, 1, 1], lifetimeSeconds: Infinity, isFrameLocked: false, points, text: "" };
    const topic = { ...content("map", 1), messages: [], markers: [marker, { ...marker, isFrameLocked: true }] };
    expect(placed([topic], "map", driving(), 25).items.map(({ pose }) => pose.position[0])).toEqual([11, 26]);
  });

  it("takes the root of the frames, unless one is chosen", () => {
    expect(fixedFrameOf(null, [content("lidar", 1)], driving())).toBe("map");
    expect(fixedFrameOf("base", [content("lidar", 1)], driving())).toBe("base");
    expect(fixedFrameOf(null, [content("camera", 1)], new TransformBuffer())).toBe("camera");
    expect([fixedFrameOf(null, [], driving()), fixedFrameOf(null, [], new TransformBuffer())]).toEqual(["map", ""]);
  });
});

describe("colours", () => {
  it("offer channels and axes", () => {
    const points = pointSet([3, NaN, 7]);
    expect(colourFields(points)).toEqual(["intensity", "x", "y", "z"]);
    expect([colourFieldOf(points, null), colourFieldOf(points, "y"), colourFieldOf(points, "gone"), colourFieldOf(points, "")]).toEqual(["intensity", "y", "intensity", ""]);
  });

  it("spread values over their range", () => {
    const points = pointSet([3, NaN, 7, 5]);
    expect([...(sharesOf(points, "intensity") ?? [])]).toEqual([0, -1, 1, 0.5]);
    expect([...(sharesOf(points, "y") ?? [])].map((share) => Number(share.toFixed(4)))).toEqual([1, 0.6667, 0.3333, 0]);
    expect([...(sharesOf(pointSet([4, 4]), "intensity") ?? [])]).toEqual([0, 0]);
    expect([sharesOf(pointSet([NaN]), "intensity"), sharesOf(points, "")]).toEqual([null, null]);
  });

  // The polynomial of turbo is further from its table than that of viridis.
  it.each([
    ["turbo", 34, [[48, 18, 59], [164, 252, 60], [122, 4, 3]]],
    ["viridis", 5, [[68, 1, 84], [33, 145, 140], [253, 231, 37]]],
  ] as const)("are close to the published table of %s", (map: ColourMap, rounding, expected) => {
    const table = colourTable(map);
    [0, 128, 255].forEach((place, row) => {
      expected[row]?.forEach((value, channel) => expect(Math.abs((table[4 * place + channel] ?? 0) - value)).toBeLessThanOrEqual(rounding));
      expect(table[4 * place + 3]).toBe(255);
    });
  });
});
