import { describe, expect, it } from "vitest";
import { locationsOf } from "./locations";
import { roughParts } from "./rough_tracks";
import { EMPTY_TRACK, mapShapes, MAX_TRACK_POINTS, trackPlaces, withPositions, type Track } from "./track";
import { locationOf } from "@/recordings/products/location";
import type { ReadMessage } from "@/recordings/products/products";

const ZURICH = { latitude: 47.3769, longitude: 8.5417 };

function message(number: number, position: { latitude: number; longitude: number } | null): ReadMessage<"position"> {
  const product = { position: position === null ? null : { ...position, altitude: null }, shapes: [] };
  return { logTimeNs: BigInt(number), publishTimeNs: 0n, sequence: 0, sizeBytes: 0, product };
}

const along = (count: number, first = 0): ReadMessage<"position">[] => Array.from({ length: count }, (_, number) => message(first + number, { ...ZURICH, longitude: 8 + number * 1e-6 }));

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

describe("the track of a preview", () => {
  const file = { id: "f", path: "f.mcap", format: "mcap", size_bytes: 1, span: { fromNs: 0n, toNs: 99n } } as const;
  const positions = (...pairs: readonly (readonly [number, number])[]) => Float64Array.from(pairs.flatMap(([latitude, longitude]) => [latitude, longitude, Number.NaN]));
  const track = { timesNs: BigInt64Array.from([0n, 30n, 60n, 90n]), positions: positions([47, 8], [47.1, 8.1], [47.2, 8.2], [47.3, 8.3]) };

  it("fills the parts that were not read, each by a line of its own", () => {
    const rough = roughParts([{ file, track }], [{ fileId: "f", fromNs: 20n, toNs: 40n }]);
    expect(rough.map(({ content }) => content.points.map(({ timeNs, isStart }) => [timeNs, isStart]))).toEqual([[[0n, true]], [[60n, true], [90n, false]]]);
    expect(trackPlaces(rough, 0.5)).toHaveLength(3);
  });

  it("is nothing where all was read, and leaves out what is no position", () => {
    expect(roughParts([{ file, track }], [{ fileId: "f", fromNs: 0n, toNs: 99n }])).toEqual([]);
    const wrong = { timesNs: track.timesNs, positions: positions([Number.NaN, 8], [91, 8], [47, -181], [47, 8]) };
    expect(roughParts([{ file, track: wrong }], [])[0]?.content.points).toEqual([{ latitude: 47, longitude: 8, altitude: null, timeNs: 90n, isStart: true }]);
  });
});

describe("the locations of a mission", () => {
  it("are the fields with coordinates, by the name of the place or of the field", () => {
    const metadata = { robot: "anymal", site: { ...ZURICH, name: "Yard" }, goal: { latitude: -1, longitude: 180 }, depot: "Zurich" };
    expect(locationsOf(metadata)).toEqual([{ ...ZURICH, name: "Yard" }, { latitude: -1, longitude: 180, name: "goal" }]);
  });

  it("leave out what is none, and are bounded", () => {
    expect(locationsOf({ a: { latitude: 91, longitude: 0 }, b: { latitude: "47", longitude: 8 }, c: null, d: [1, 2], e: { latitude: Number.NaN, longitude: 0 } })).toEqual([]);
    expect(locationsOf(Object.fromEntries(Array.from({ length: 500 }, (_, number) => [`field${number}`, ZURICH])))).toHaveLength(100);
  });
});
