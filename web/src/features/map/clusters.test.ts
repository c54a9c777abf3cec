import { describe, expect, it } from "vitest";
import { clustersOf, extentOf } from "./clusters";
import { worldPoint } from "@/components/map/map_view";

const ZURICH = { latitude: 47.3769, longitude: 8.5417 };
const place = (name: string, latitude: number, longitude: number) => ({ ...worldPoint({ latitude, longitude }), name });
const scaleOf = (zoom: number): number => 256 * 2 ** zoom;
const namesOf = (clusters: readonly { readonly members: readonly { readonly name: string }[] }[]): string[][] => clusters.map(({ members }) => members.map(({ name }) => name));

const zurich = place("zurich", ZURICH.latitude, ZURICH.longitude);
const oerlikon = place("oerlikon", 47.41, 8.545);
const bern = place("bern", 46.948, 7.4474);

describe("clusters", () => {
  it("hold what is near on the screen, and come apart as the map is zoomed", () => {
    const places = [zurich, oerlikon, bern];
    expect(namesOf(clustersOf(places, scaleOf(4)))).toEqual([["zurich", "oerlikon", "bern"]]);
    expect(namesOf(clustersOf(places, scaleOf(8)))).toEqual([["zurich", "oerlikon"], ["bern"]]);
    expect(namesOf(clustersOf(places, scaleOf(13)))).toEqual([["zurich"], ["oerlikon"], ["bern"]]);
  });

  it("stay the same for a little zoom", () => {
    const places = Array.from({ length: 300 }, (_, number) => place(`${number}`, 47 + ((number * 37) % 100) / 500, 8 + ((number * 61) % 100) / 500));
    expect(namesOf(clustersOf(places, scaleOf(11) * 1.2))).toEqual(namesOf(clustersOf(places, scaleOf(11) * 0.9)));
  });

  it("lose and repeat no place, and are in the middle of theirs", () => {
    const places = Array.from({ length: 2_000 }, (_, number) => place(`${number}`, -80 + (number % 161), -179 + ((number * 7) % 359)));
    const clusters = clustersOf(places, scaleOf(3));
    expect(clusters.flatMap(({ members }) => members.map(({ name }) => name)).toSorted()).toEqual(places.map(({ name }) => name).toSorted());
    expect(clusters.length).toBeGreaterThan(10);
    expect(clusters.length).toBeLessThan(2_000);
    const [both] = clustersOf([zurich, oerlikon], scaleOf(4));
    expect(both?.x).toBeCloseTo((zurich.x + oerlikon.x) / 2, 12);
  });

  it("know how far apart their places are", () => {
    // 0.001 degrees of longitude at this latitude: 6378137 m × cos φ × 0.001° = 75.38 m (spherical Mercator).
    const [cluster] = clustersOf([zurich, place("other", ZURICH.latitude, ZURICH.longitude + 0.001)], scaleOf(4));
    expect(cluster === undefined ? 0 : extentOf(cluster)).toBeCloseTo(75.38, 1);
    const [single] = clustersOf([zurich], scaleOf(4));
    expect(single === undefined ? 1 : extentOf(single)).toBe(0);
  });
});
