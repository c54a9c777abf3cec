import { describe, expect, it } from "vitest";
import { datesOf, dayOf, densityPath, endOfDay, longestGap, shareOf, spanEnd, startOfDay, ticks } from "./time";

const NOON = Date.UTC(2026, 4, 1, 12, 0, 0);

describe("round times", () => {
  it.each([
    [30, 6], [600, 5], [3600, 8], [86_400 * 3, 4], [86_400 * 900, 10], [0.02, 5],
  ])("%d s with room for %d", (seconds, most) => {
    const marks = ticks(NOON, NOON + seconds * 1000, most);
    expect(marks.length).toBeGreaterThan(0);
    expect(marks.length).toBeLessThanOrEqual(most + 1);
    for (const tick of marks) {
      expect(tick.share).toBeGreaterThanOrEqual(0);
      expect(tick.share).toBeLessThanOrEqual(1);
      expect(tick.label).not.toBe("");
    }
  });
  it("stand at whole minutes", () => {
    const marks = ticks(NOON + 1, NOON + 300_000, 5);
    expect(marks.map((tick) => tick.at % 60_000)).toEqual(marks.map(() => 0));
  });
  it("has none on a span of nothing", () => expect(ticks(NOON, NOON, 5)).toEqual([]));
});

describe("the date of an axis", () => {
  const noon = new Date(2026, 4, 1, 12).getTime(); // in the zone of whoever looks
  it("is named once, with the zone of its times", () => {
    expect(datesOf(noon, noon + 3_600_000)).toMatch(/^1 May 2026, UTC([+-]\d+(:\d\d)?)?$/);
  });
  it("names both ends of a span of several days", () => {
    expect(datesOf(noon, noon + 2 * 86_400_000)).toMatch(/^1 May 2026 – 3 May 2026, UTC/);
  });
  it("stands at midnight in place of a time", () => {
    const labels = ticks(noon, noon + 86_400_000, 4).map((tick) => tick.label);
    expect(labels).toContain("2 May");
    expect(labels).toContain("18:00");
  });
});

it("keeps to the span", () => {
  expect(shareOf(5, 0, 10)).toBe(0.5);
  expect(shareOf(-5, 0, 10)).toBe(0);
  expect(shareOf(50, 0, 10)).toBe(1);
  expect(shareOf(5, 10, 10)).toBe(0);
});

it("a day holds to its end, where the viewer is", () => {
  expect(new Date(endOfDay("2026-11-21")).getHours()).toBe(23);
  expect(dayOf(new Date(endOfDay("2026-11-21")))).toBe("2026-11-21");
});

it("days follow one another without a gap", () => {
  expect(startOfDay("2026-12-31", 1)).toBe(startOfDay("2027-01-01"));
  expect(Date.parse(startOfDay("2026-03-29", 1))).toBeGreaterThan(Date.parse(endOfDay("2026-03-29")));
});

it("spans are whole days", () => {
  expect(dayOf(new Date(spanEnd("30", new Date("2026-11-21T12:00:00"))))).toBe("2026-12-21");
});

it("draws nothing of nothing", () => {
  expect(densityPath([])).toBe("");
  expect(densityPath([0, 0])).toBe("");
});

it("draws equal neighbours as one, and leaves gaps open", () => {
  expect(densityPath([4, 4, 0, 4])).toBe("M0 1V0.000H2V1ZM3 1V0.000H4V1Z");
});

it("lets a lone message be seen beside many", () => {
  expect(densityPath([1, 10_000])).toContain("M0 1V0.800H1V1Z");
});

it("finds the longest gap between, not before or after", () => {
  expect(longestGap([0, 0, 0, 1, 0, 0, 1, 0, 1, 0])).toBeCloseTo(0.2);
  expect(longestGap([0, 0])).toBe(0);
});
