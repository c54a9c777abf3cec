import { describe, expect, it } from "vitest";
import { rowsOf } from "./csv";
import { scaleOf, trackOf } from "./track";

describe("a table", () => {
  it("is read as spreadsheets write it", () => {
    expect(rowsOf('\ufeffa,"b ""c"", d"\r\n1,\n"two\nlines",3', 10)).toEqual({ rows: [["a", 'b "c", d'], ["1", ""], ["two\nlines", "3"]], count: 3 });
  });
  it("is counted whole, and shown in part", () => {
    expect(rowsOf("a\n1\n2\n3\n", 2)).toEqual({ rows: [["a"], ["1"]], count: 4 });
  });
  it("ends also where a quote does not", () => {
    expect(rowsOf('a,"b', 5)).toEqual({ rows: [["a", "b"]], count: 1 });
  });
});

describe("a track", () => {
  it("is in metres, with north up", () => {
    const track = trackOf({ type: "Feature", geometry: { type: "LineString", coordinates: [[8, 0], [8.001, 0], [8.001, 0.001]] } });
    expect(track?.points).toBe(3);
    expect(track?.lines[0]?.map(([x, y]) => [Math.round(x), Math.round(y) + 0])).toEqual([[0, 0], [111, 0], [111, -111]]);
  });
  it("is made of lone points too", () => {
    const point = (longitude: number) => ({ type: "Feature", geometry: { type: "Point", coordinates: [longitude, 47] } });
    expect(trackOf({ type: "FeatureCollection", features: [point(8), point(9)] })?.lines).toHaveLength(1);
  });
  it("is nothing where there are no places", () => {
    for (const none of [null, 3, "text", [], { type: "LineString", coordinates: [["8", "47"], [900, 900]] }]) expect(trackOf(none)).toBeNull();
  });
  it("has a scale of a round length", () => {
    expect([scaleOf(100), scaleOf(260), scaleOf(3)]).toEqual([20, 50, 0.5]);
  });
});
