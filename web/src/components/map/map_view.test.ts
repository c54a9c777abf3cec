import { describe, expect, it } from "vitest";
import { fitted, gridLines, latitudeOf, linePath, longitudeOf, metresPerPixel, nearest, panned, scaleBar, toPixels, worldPoint, zoomed } from "./map_view";
import { tilesOf } from "./tiles";

const SIZE = { width: 400, height: 300 };
const ZURICH = { latitude: 47.3769, longitude: 8.5417 };
const SOURCE = { url: "https://tiles.example/{z}/{x}/{y}.png", max_zoom: 19 };

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

describe("places", () => {
  it("have the coordinates that they were made of, on either side of the date line", () => {
    for (const longitude of [-179.5, -8, 0, 8.5417, 179.5]) {
      const place = worldPoint({ latitude: 47.3769, longitude }, 1.2);
      expect(latitudeOf(place)).toBeCloseTo(47.3769, 9);
      expect(longitudeOf(place)).toBeCloseTo(longitude, 9);
    }
  });

  it("at the poles are at the edge of the map", () => {
    expect(worldPoint({ latitude: 90, longitude: 0 }).y).toBeCloseTo(0, 6);
    expect(worldPoint({ latitude: -90, longitude: 0 }).y).toBeCloseTo(1, 6);
  });
});

describe("tiles", () => {
  const viewAt = (zoom: number, place = worldPoint(ZURICH)) => ({ centre: place, scale: 256 * 2 ** zoom });

  it("are those of the scheme, and cover the area", () => {
    // Source of the numbers: column = floor((lon + 180) / 360 × 2^z), row = floor((1 − asinh(tan lat) / π) / 2 × 2^z).
    const tiles = tilesOf(SOURCE, viewAt(12), SIZE);
    const centre = tiles.find(({ left, top, size }) => left <= 200 && left + size > 200 && top <= 150 && top + size > 150);
    expect(centre?.url).toBe("https://tiles.example/12/2145/1434.png");
    expect(Math.min(...tiles.map(({ left }) => left))).toBeLessThanOrEqual(0);
    expect(Math.max(...tiles.map(({ left, size }) => left + size))).toBeGreaterThanOrEqual(400);
    expect(new Set(tiles.map(({ key }) => key)).size).toBe(tiles.length);
  });

  it("are enlarged beyond the greatest zoom", () => {
    const tiles = tilesOf({ ...SOURCE, max_zoom: 10 }, viewAt(14), SIZE);
    expect(tiles.every(({ url, size }) => url.startsWith("https://tiles.example/10/") && size === 256 * 16)).toBe(true);
    expect(tiles.length).toBeGreaterThan(0);
  });

  it("repeat beyond the date line, and end at the poles", () => {
    const tiles = tilesOf(SOURCE, viewAt(3, { x: 0.999, y: 0.01 }), SIZE);
    expect(new Set(tiles.map(({ url }) => url.split("/")[4]))).toEqual(new Set(["7", "0"]));
    expect(tiles.every(({ key }) => Number(key.split("/")[2]) >= 0)).toBe(true);
  });

  it("are those of a lower zoom where they would be too many", () => {
    const size = { width: 7_680, height: 4_320 }; // 31 × 17 tiles of the nearest zoom
    const tiles = tilesOf(SOURCE, viewAt(12), size);
    expect(new Set(tiles.map((tile) => `${tile.url.split("/")[3]} ${tile.size}`))).toEqual(new Set(["11 512"]));
    expect(tiles.length).toBeLessThanOrEqual(200);
    expect(Math.min(...tiles.map(({ left }) => left))).toBeLessThanOrEqual(0);
    expect(Math.max(...tiles.map(({ top, size: pixels }) => top + pixels))).toBeGreaterThanOrEqual(4_320);
    const huge = tilesOf(SOURCE, viewAt(12), { width: 1e6, height: 1e6 });
    expect(huge.length).toBeGreaterThan(50);
    expect(huge.length).toBeLessThanOrEqual(200);
  });

  it("are none where nothing is to be seen, or where the world would be drawn very often", () => {
    expect(tilesOf(SOURCE, viewAt(3), { width: 0, height: 0 })).toEqual([]);
    expect(tilesOf(SOURCE, viewAt(0), { width: 256 * 300, height: 300 })).toEqual([]);
  });
});
