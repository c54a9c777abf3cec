import { expect, it } from "vitest";
import { dayOf, endOfDay } from "./dates";

it("a right that ends with a day shows that day", () => {
  expect(dayOf(endOfDay("2026-11-21"))).toBe("2026-11-21");
  expect(dayOf(endOfDay("2026-02-28"))).toBe("2026-02-28");
  expect(new Date(endOfDay("2026-11-21")).getDate()).toBe(22);
  expect(dayOf(null)).toBe("");
});
