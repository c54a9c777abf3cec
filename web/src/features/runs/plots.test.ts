import { expect, it } from "vitest";
import { areaOf, levels, most, rates } from "./plots";

const usage = (cpu: number, memory: number) => ({ cpu_s: cpu, memory_bytes: memory, peak_memory_bytes: memory, read_bytes: 0, written_bytes: 0 });
const samples = [{ at_s: 1, usage: usage(0, 10) }, { at_s: 3, usage: usage(4, 30) }, { at_s: 3, usage: usage(4, 30) }, { at_s: 5, usage: usage(5, 20) }];

it("a rate is what a sum grew by, over the time that took", () => {
  expect(rates(samples, "cpu_s")).toEqual({ at: [3, 5], values: [2, 0.5] });
});

it("an area reaches from the first moment to the last, and as high as the most", () => {
  expect(most(levels(samples, "memory_bytes"))).toBe(30);
  expect(areaOf({ at: [1, 3, 5], values: [1, 2, 0] })).toBe("M0 1L0.00 0.5000L50.00 0.0000L100.00 1.0000L100 1Z");
  expect(areaOf({ at: [], values: [] })).toBe("");
});
