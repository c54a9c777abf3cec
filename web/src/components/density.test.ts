import { expect, it } from "vitest";
import { densityPath, longestGap } from "./density";

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
