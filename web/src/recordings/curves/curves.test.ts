import { describe, expect, it } from "vitest";
import { CurveCollector, MAX_POINTS } from "./curves";

function collect(count: number, hz: number, value: (at: number) => number | null): CurveCollector {
  const collector = new CurveCollector(1, 0, count / hz);
  for (let number = 0; number < count; number++) collector.add(number / hz, [value(number)]);
  return collector;
}

describe("CurveCollector", () => {
  it("keeps every point while they are few", () => {
    const { seconds, values, isWhole } = collect(MAX_POINTS, 100, (at) => at * 2).curves();
    expect(isWhole).toBe(true);
    expect(seconds).toHaveLength(MAX_POINTS);
    expect(values[0]?.[4321]).toBe(8642);
  });

  it("keeps the extremes of many points, wherever they are", () => {
    const { seconds, values, isWhole, messages } = collect(300_000, 1000, (at) => (at === 123_456 ? 99 : at === 200_001 ? -99 : Math.sin(at))).curves();
    expect(isWhole).toBe(false);
    expect(messages).toBe(300_000);
    expect(seconds.length).toBeLessThan(4_000);
    const curve = values[0] ?? [];
    expect(seconds[curve.indexOf(99)]).toBe(123.456);
    expect(seconds[curve.indexOf(-99)]).toBe(200.001);
    expect(seconds.toSorted((a, b) => a - b)).toEqual(seconds);
  });

  it.each([1_000, 100_000])("breaks the curve of %i points where the topic was silent", (count) => {
    const collector = new CurveCollector(2, 0, count / 100 + 10);
    for (let number = 0; number < count; number++) {
      collector.add(number / 100 + (number > count / 2 ? 10 : 0), [number, -number]);
    }
    const { seconds, values } = collector.curves();
    const breaks = seconds.filter((_, row) => values[0]?.[row] === null);
    expect(breaks).toHaveLength(1);
    expect(breaks[0]).toBeCloseTo(count / 200 + 5, 1);
    expect(values[1]?.[seconds.indexOf(breaks[0] ?? -1)]).toBeNull();
  });

  it("breaks nothing where messages come evenly, or all at once", () => {
    expect(collect(500, 10, (at) => at).curves().values[0]).not.toContain(null);
    expect(collect(500, Infinity, (at) => at).curves().seconds).toHaveLength(500);
  });

  it("shows what is no number as missing", () => {
    expect(collect(3, 1, (at) => (at === 1 ? null : at)).curves().values).toEqual([[0, null, 2]]);
    expect(new CurveCollector(2, 0, 1).curves()).toMatchObject({ seconds: [], values: [[], []] });
  });
});
