import { expect, it } from "vitest";
import { MAX_PANELS, moved, panelOf, panelsOf, panelText, timeOf, type Panel } from "./layout";

const panel: Panel = {
  kind: "plot",
  isWide: true,
  series: [
    { recording: "04cf00a6", topic: "/imu", fields: ["linear_acceleration.x", 'odd["a,b;c!d"]'] },
    { recording: "38c937c5", topic: "a@b:c%20/ü", fields: [] },
  ],
};

it("writes a panel into an address and reads the same", () => {
  expect(panelOf(panelText(panel))).toEqual(panel);
  const through = new URL(`http://x/?p=${encodeURIComponent(panelText(panel))}`).searchParams.get("p") ?? "";
  expect(panelOf(through)).toEqual(panel);
});

it("keeps the time that a plot shows, and has none where an earlier version wrote none", () => {
  const headerTime: Panel = { ...panel, isHeaderTime: true };
  expect(panelText(headerTime)).toMatch(/^plot\*@header:04cf00a6@/);
  expect(panelOf(panelText(headerTime))).toEqual(headerTime);
  expect(panelOf("plot@header:a@/x")).toEqual({ kind: "plot", isWide: false, isHeaderTime: true, series: [{ recording: "a", topic: "/x", fields: [] }] });
  expect(panelOf("plot@other:a@/x")).toBeNull();
});

it("leaves out what describes no panel", () => {
  expect(panelsOf(["", "plot", "plot:", "image:@/x", "Image:a@/x", "image:a@/x"])).toEqual([{ kind: "image", isWide: false, series: [{ recording: "a", topic: "/x", fields: [] }] }]);
});

it("has a limit", () => {
  expect(panelsOf(Array.from({ length: 1000 }, () => "image:a@/x"))).toHaveLength(MAX_PANELS);
});

it("moves panels within their list", () => {
  const panels = ["a", "b", "c"].map((kind) => ({ ...panel, kind }));
  const kinds = (place: number, by: number): string => moved(panels, place, by).map(({ kind }) => kind).join("");
  expect([kinds(0, 1), kinds(2, -1), kinds(0, -1), kinds(2, 1), kinds(7, 1)]).toEqual(["bac", "acb", "abc", "abc", "abc"]);
});

it("reads log times and nothing else", () => {
  expect(["1700000000123456789", "", "-1", "1.5", "99999999999999999999"].map(timeOf)).toEqual([1700000000123456789n, null, null, null, null]);
});
