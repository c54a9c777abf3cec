import { describe, expect, it } from "vitest";
import { fitted, gridLines, linePath, metresPerPixel, nearest, panned, scaleBar, toPixels, worldPoint, zoomed } from "./map_view";
import { EMPTY_TRACK, mapShapes, MAX_TRACK_POINTS, trackPlaces, withPositions, type Track } from "./track";
import { locationOf } from "@/recordings/products/location";
import type { ReadMessage } from "@/recordings/products/products";

const SIZE = { width: 400, height: 300 };
const ZURICH = { latitude: 47.3769, longitude: 8.5417 };

function message(number: number, position: { latitude: number; longitude: number } | null): ReadMessage<"location"> {
  const product = { position: position === null ? null : { ...position, altitude: null }, shapes: [] };
  return { logTimeNs: BigInt(number), publishTimeNs: 0n, sequence: 0, sizeBytes: 0, product };
}

const along = (count: number, first = 0): ReadMessage<"location">[] => Array.from({ length: count }, (_, number) => message(first + number, { ...ZURICH, longitude: 8 + number * 1e-6 }));

describe("a map", () => {
  it("shows distances as they are at the latitude", () => {
    // 0.001 degrees of longitude at this latitude: 6378137 m × cos φ × 0.001° = 75.38 m (spherical Mercator).
    const view = fitted([worldPoint(ZURICH)], SIZE);
    const [a, b] = [ZURICH, { ...ZURICH, longitude: ZURICH.longitude + 0.001 }].map((one) => toPixels(view, SIZE, worldPoint(one)));
    expect(((b?.left ?? 0) - (a?.left ?? 0)) * metresPerPixel(view)).toBeCloseTo(75.38, 1);
  });

  it("fits all places, and a single one with its surroundings", () => {
    const places = [worldPoint({ latitude: 47, longitude: 8 }), worldPoint({ latitude: 48, longitude: 9 })];
    const view = fitted(places, SIZE);
    for (const place of places) {
      const { left, top } = toPixels(view, SIZE, place);
      expect(left > 0 && left < SIZE.width && top > 0 && top < SIZE.height).toBe(true);
    }
    expect(metresPerPixel(fitted([worldPoint(ZURICH)], SIZE)) * SIZE.height).toBeCloseTo(20 / 0.85, 0);
  });

  it("keeps the place below the pointer while zooming, and follows a drag", () => {
    const view = fitted([worldPoint(ZURICH)], SIZE);
    const at = { left: 90, top: 220 };
    const place = { x: view.centre.x + (at.left - 200) / view.scale, y: view.centre.y + (at.top - 150) / view.scale };
    const after = toPixels(zoomed(view, 3, SIZE, at), SIZE, place);
    expect([after.left, after.top].map((pixel) => Math.round(pixel * 10) / 10)).toEqual([90, 220]);
    expect(toPixels(panned(view, 30, -20), SIZE, place).left).toBeCloseTo(120, 3);
  });

  it("has a scale bar of a round length, and a grid of that width", () => {
    const view = fitted([worldPoint({ latitude: 0, longitude: 0 }), worldPoint({ latitude: 0, longitude: 0.01 })], SIZE);
    const bar = scaleBar(view, 110);
    expect(bar.metres).toBe(200);
    expect(bar.pixels).toBeLessThanOrEqual(110);
    const { lefts } = gridLines(view, SIZE, worldPoint({ latitude: 0, longitude: 0 }), bar.pixels);
    expect((lefts[1] ?? 0) - (lefts[0] ?? 0)).toBeCloseTo(bar.pixels, 6);
    expect(lefts.length).toBeLessThan(10);
  });

  it("draws a track across the date line in one piece", () => {
    const first = worldPoint({ latitude: 0, longitude: 179.9 });
    expect(worldPoint({ latitude: 0, longitude: -179.9 }, first.x).x - first.x).toBeCloseTo(0.2 / 360, 9);
  });

  it("draws only what differs by a pixel, with the ends of lines", () => {
    const view = { centre: { x: 0.5, y: 0.5 }, scale: 100 };
    const places = Array.from({ length: 1_000 }, (_, number) => ({ x: 0.5 + number * 1e-5, y: 0.5, isStart: number === 0 }));
    const path = linePath(view, SIZE, places);
    expect(path.match(/[ML]/g)).toHaveLength(3);
    expect(path.endsWith("L201.0 150.0")).toBe(true);
  });

  it("finds the nearest point within reach of a click", () => {
    const view = { centre: { x: 0.5, y: 0.5 }, scale: 1_000 };
    const places = [{ x: 0.5, y: 0.5 }, { x: 0.51, y: 0.5 }];
    expect(nearest(view, SIZE, places, { left: 208, top: 151 }, 24)).toBe(places[1]);
    expect(nearest(view, SIZE, places, { left: 300, top: 150 }, 24)).toBeNull();
  });
});

describe("a track", () => {
  it("leaves out messages without a position, counts them, and is broken there", () => {
    const track = withPositions(EMPTY_TRACK, [message(1, ZURICH), message(2, null), message(3, null), message(4, ZURICH), message(5, ZURICH)]);
    expect(track.points.map(({ timeNs, isStart }) => [timeNs, isStart])).toEqual([[1n, true], [4n, true], [5n, false]]);
    expect([track.positions, track.missing]).toEqual([3, 2]);
  });

  it("stays small however many messages it has, and evenly thinned", () => {
    let track: Track = EMPTY_TRACK;
    for (let page = 0; page < 50; page += 1) track = withPositions(track, along(2_000, page * 2_000));
    expect(track.positions).toBe(100_000);
    expect(track.points.length).toBeLessThanOrEqual(MAX_TRACK_POINTS);
    const steps = new Set(track.points.slice(1).map(({ timeNs }, place) => timeNs - (track.points[place]?.timeNs ?? 0n)));
    expect([...steps]).toEqual([32n]);
  });

  it("continues over parts that adjoin, and is broken by a gap", () => {
    const part = (fromNs: bigint, toNs: bigint) => ({ fileId: "f", fromNs, toNs, content: withPositions(EMPTY_TRACK, [message(Number(fromNs), ZURICH)]) });
    expect(trackPlaces([part(0n, 9n), part(10n, 19n), part(30n, 39n)], 0.5).map(({ isStart }) => isStart)).toEqual([true, false, true]);
  });
});

describe("the location of a message", () => {
  it("is none without a fix, or with a position that is none", () => {
    expect(locationOf({ ...ZURICH, altitude: 400, status: { status: 0 } }).position).toEqual({ ...ZURICH, altitude: 400 });
    expect(locationOf({ ...ZURICH, altitude: Number.NaN, status: { status: 2 } }).position).toEqual({ ...ZURICH, altitude: null });
    expect(locationOf({ ...ZURICH, status: { status: -1 } }).position).toBeNull();
    expect(locationOf({ latitude: Number.NaN, longitude: 8, status: { status: 0 } }).position).toBeNull();
    expect(locationOf({ latitude: 91, longitude: 8 }).position).toBeNull();
    expect(locationOf({ pose: { position: { ...ZURICH, altitude: 1 } } }).position).toEqual({ ...ZURICH, altitude: 1 });
  });

  it("is the shapes of GeoJSON, whose longitude comes first", () => {
    const line = { type: "LineString", coordinates: [[8.5, 47.3], [8.6, 47.4, 500]] };
    const area = { type: "Polygon", coordinates: [[[8, 47], [9, 47], [9, 48], [8, 47]]] };
    const geojson = JSON.stringify({ type: "FeatureCollection", features: [{ type: "Feature", geometry: line }, { type: "Feature", geometry: { type: "GeometryCollection", geometries: [area] } }] });
    const { shapes } = locationOf({ geojson });
    expect(shapes.map(({ kind, positions }) => [kind, positions.length])).toEqual([["line", 2], ["area", 4]]);
    expect(shapes[0]?.positions[1]).toEqual({ latitude: 47.4, longitude: 8.6, altitude: 500 });
    const drawn = mapShapes({ position: null, shapes }, 0.5);
    expect([drawn.lines.map(({ isStart }) => isStart), drawn.areas.length, drawn.points.length]).toEqual([[true, false], 4, 0]);
  });

  it("is bounded, and damaged GeoJSON is a named failure", () => {
    const coordinates = Array.from({ length: 50_000 }, () => [8, 47]);
    expect(locationOf({ geojson: JSON.stringify({ type: "LineString", coordinates }) }).shapes[0]?.positions).toHaveLength(20_000);
    expect(() => locationOf({ geojson: "{" })).toThrow(/message_damaged: no GeoJSON/);
    const nested = `${'{"type":"GeometryCollection","geometries":['.repeat(500)}${"]}".repeat(500)}`;
    expect(locationOf({ geojson: nested }).shapes).toEqual([]);
  });
});
