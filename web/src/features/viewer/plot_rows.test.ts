import { expect, it } from "vitest";
import type { Segment, SeriesState } from "./curves";
import { curveOf } from "./plot_curves";
import { differences, drawnCurves, isZoomNeeded, operandsOf, plotRows, whollyRead } from "./plot_rows";
import type { Span } from "@/recordings/formats/recording";

const axis = { time: "log", secondsOf: Number } as const;

function segment(fromNs: bigint, toNs: bigint, more: Partial<Segment> = {}): Segment {
  return { fileId: "f", fromNs, toNs, seconds: [], values: [], messages: 0, isWhole: true, topicBytes: 0, unstamped: 0, ...more };
}

function state(texts: readonly string[], segments: readonly Segment[], more: Partial<SeriesState> = {}): SeriesState {
  const curves = texts.map(curveOf);
  return { curves, columns: curves.map(({ column }) => column), fields: [], segments, rough: [], unread: [], wholeBytes: 0, isReading: false, readAll: () => undefined, ...more };
}

const MINUS = "difference(x,r@/b,y)";
const SERIES = [{ recording: "r", topic: "/a", fields: [MINUS, "x"] }, { recording: "r", topic: "/b", fields: ["y"] }];
const A = [segment(0n, 100n, { seconds: [0, 10, 20, 30, 90], values: [[1, 2, null, 4, 5]] })];
const B = [segment(0n, 40n, { seconds: [5, 20, 25], values: [[100, 200, 300]] }), segment(80n, 100n, { seconds: [95], values: [[400]] })];

function rows(a: SeriesState, b: SeriesState) {
  return plotRows(SERIES, new Map([["r /a", a], ["r /b", b]]));
}

const readA = (segments = A): SeriesState => state([MINUS, "x"], segments, { columns: ["x"] });

it("subtracts the value that was valid at the time of each point, where it is known", () => {
  const [known] = [whollyRead({ segments: B, unread: [] }, 0, axis)];
  expect(known.spans).toEqual([[0, 40], [80, 100]]);
  // Nothing at 0 s, before the first value; at 90 s, the value from before the unread part may be outdated.
  expect(differences(A[0] as Segment, 0, known)).toEqual([null, 2 - 100, null, 4 - 300, null]);
});

it("goes on with a value over segments that touch", () => {
  const touching = [segment(0n, 20n, { seconds: [5], values: [[100]] }), segment(21n, 100n, { seconds: [95], values: [[400]] })];
  expect(differences(A[0] as Segment, 0, whollyRead({ segments: touching, unread: [] }, 0, axis))).toEqual([null, -98, null, -96, -95]);
});

it("subtracts nothing of what is known by its extremes only", () => {
  expect(differences(A[0] as Segment, 0, whollyRead({ segments: [segment(0n, 100n, { ...B[0], isWhole: false })], unread: [] }, 0, axis))).toEqual([null, null, null, null, null]);
  expect(differences({ ...(A[0] as Segment), isWhole: false }, 0, whollyRead({ segments: B, unread: [] }, 0, axis))).toEqual([]);
});

it("subtracts nothing behind the last stamp of a part that was read: messages that were logged later may be stamped before", () => {
  // Stamped 5 s before they are logged: what is stamped 38 s is logged at 43 s, behind the part that was read.
  const stamped = [segment(20n, 40n, { seconds: [17, 33], values: [[100, 300]] })];
  const a = segment(0n, 100n, { seconds: [10, 17, 25, 33, 36, 39, 60], values: [[1, 2, 3, 4, 5, 6, 7]] });
  const header = { ...axis, time: "header" } as const;
  const minus = (unread: readonly Span[]): unknown => differences(a, 0, whollyRead({ segments: stamped, unread }, 0, header));
  const before = { fromNs: 0n, toNs: 19n };
  expect(minus([before, { fromNs: 41n, toNs: 100n }])).toEqual([null, 2 - 100, 3 - 100, 4 - 300, null, null, null]);
  // Where nothing follows, the last value is valid up to the end.
  expect(minus([before])).toEqual([null, -98, -97, -296, 5 - 300, 6 - 300, null]);
});

it("draws differences beside the fields", () => {
  const { seconds, values } = drawnCurves(rows(readA(), state(["y"], B)), axis);
  const at = (second: number): (number | null | undefined)[] => values.map((curve) => curve[seconds.indexOf(second)]);
  expect(values).toHaveLength(3);
  expect(at(10)).toEqual([-98, 2, undefined]);
  expect(at(20)).toEqual([null, null, 200]);
});

it("draws no difference from a topic that is not there", () => {
  const { values } = drawnCurves(plotRows(SERIES.slice(0, 1), new Map([["r /a", readA()]])), axis);
  expect(values[0]?.every((value) => value === null)).toBe(true);
  expect(values[1]).toContain(5);
});

it("reads the fields that curves of other topics subtract", () => {
  expect(operandsOf(SERIES, { recording: "r", topic: "/b" })).toEqual(["y"]);
  expect(operandsOf(SERIES, { recording: "r", topic: "/a" })).toEqual([]);
});

it("needs a zoom where a computed curve misses", () => {
  const thinned = [segment(0n, 100n, { seconds: [1], values: [[1]], isWhole: false })];
  expect(isZoomNeeded(rows(readA(), state(["y"], B)))).toBe(false);
  expect(isZoomNeeded(rows(readA(), state(["y"], thinned)))).toBe(true);
  expect(isZoomNeeded(rows(state(["x"], A, { rough: thinned }), state(["y"], thinned)))).toBe(false);
  expect(isZoomNeeded(rows(state(["norm(x)"], A, { rough: thinned }), state(["y"], B)))).toBe(true);
  expect(isZoomNeeded(rows(state(["norm(x)"], thinned), state(["y"], B)))).toBe(false); // extremes of the norm itself
});
