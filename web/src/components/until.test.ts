import { expect, it } from "vitest";
import { dayOf, endOfDay, spanEnd, startOfDay } from "./until";

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
