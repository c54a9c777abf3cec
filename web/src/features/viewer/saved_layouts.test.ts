import { describe, expect, it } from "vitest";
import { panelsOf, panelText } from "./layout";
import { fittedLayout, portableTexts } from "./saved_layouts";

const HERE = [
  { recording: "04cf00a6", name: "/imu" },
  { recording: "04cf00a6", name: "/odom" },
  { recording: "9b1c22de", name: "/imu" },
];
const ELSEWHERE = [
  { recording: "77aa0011", name: "/camera" },
  { recording: "77aa0011", name: "/imu" },
  { recording: "88bb0022", name: "/imu" },
];
const PANELS = panelsOf(["plot*:9b1c22de@/imu,linear.x,linear.y;04cf00a6@/odom", "raw:04cf00a6@/odom", "raw:04cf00a6@/imu"]);

describe("saved layouts", () => {
  it("name places among the recordings that have a topic", () => {
    expect(portableTexts(PANELS, HERE)).toEqual(["plot*:2@/imu,linear.x,linear.y;1@/odom", "raw:1@/odom", "raw:1@/imu"]);
  });

  it("fit the mission that they were saved in", () => {
    expect(fittedLayout(portableTexts(PANELS, HERE), HERE)).toEqual({ panels: PANELS, leftOut: 0 });
  });

  it("show what another mission has, and count the panels that it does not have", () => {
    const { panels, leftOut } = fittedLayout(portableTexts(PANELS, HERE), ELSEWHERE);
    expect(panels.map(panelText)).toEqual(["plot*:88bb0022@/imu,linear.x,linear.y", "raw:77aa0011@/imu"]);
    expect(leftOut).toBe(1);
  });

  it("leave out a recording that a mission does not have", () => {
    expect(fittedLayout(["raw:2@/imu", "raw:1@/imu"], HERE.slice(0, 2))).toEqual({ panels: panelsOf(["raw:04cf00a6@/imu"]), leftOut: 1 });
  });

  it("leave out panels of recordings that are gone", () => {
    expect(portableTexts(panelsOf(["raw:00000000@/imu", "raw:04cf00a6@/gone"]), HERE)).toEqual([]);
  });

  it.each(["", "raw", "raw:@/imu", "raw:0@/imu", "raw:-1@/imu", "raw:1.5@/imu", "raw:x@/imu", "raw:__proto__@/imu", "raw:1@__proto__"])("leave out what is no saved panel: %s", (text) => {
    expect(fittedLayout([text], HERE)).toEqual({ panels: [], leftOut: 1 });
  });

  it("name the recordings that curves subtract, too, and leave out curves of those that are gone", () => {
    const text = "plot@header:04cf00a6@/imu,x@right,difference(x!2c9b1c22de@/imu!2cy)@right";
    const saved = portableTexts(panelsOf([text]), HERE);
    expect(saved).toEqual(["plot@header:1@/imu,x@right,difference(x!2c2@/imu!2cy)@right"]);
    expect(fittedLayout(saved, HERE).panels.map(panelText)).toEqual([text]);
    expect(fittedLayout(saved, HERE.slice(0, 2)).panels.map(panelText)).toEqual(["plot@header:04cf00a6@/imu,x@right"]);
  });

  it("keep the fields with what separates them", () => {
    const panels = [{ kind: "plot", isWide: false, series: [{ recording: "04cf00a6", topic: "/imu", fields: ["a,b", "c;d!"] }] }];
    expect(fittedLayout(portableTexts(panels, HERE), HERE).panels).toEqual(panels);
  });
});
