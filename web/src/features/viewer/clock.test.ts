import { expect, it } from "vitest";
import { advanced, within, type ClockState } from "./clock";

const SECOND = 1_000_000_000n;
const state: ClockState = { timeNs: 0n, span: { fromNs: 0n, toNs: 100n * SECOND }, loop: null, recorded: [{ fromNs: 0n, toNs: 100n * SECOND }] };

it("goes on by the elapsed time and the speed, to the nanosecond", () => {
  const start = 1_700_000_000_123_456_789n;
  const late = { ...state, timeNs: start, span: { fromNs: start, toNs: start + 100n * SECOND }, recorded: [] };
  expect(advanced(late, 16, 1).timeNs - start).toBe(16_000_000n);
  expect(advanced(late, 16, 0.1).timeNs - start).toBe(1_600_000n);
  expect(advanced(late, 16, 10).timeNs - start).toBe(160_000_000n);
});

it("stops at the end", () => {
  expect(advanced({ ...state, timeNs: 99n * SECOND }, 2000, 1)).toEqual({ timeNs: 100n * SECOND, isAtEnd: true });
});

it("repeats a loop that it is in, and passes one that it is not in", () => {
  const loop = { fromNs: 10n * SECOND, toNs: 12n * SECOND };
  expect(advanced({ ...state, loop, timeNs: 11n * SECOND }, 1500, 1)).toEqual({ timeNs: 10n * SECOND, isAtEnd: false });
  expect(advanced({ ...state, loop, timeNs: 13n * SECOND }, 1000, 1)).toEqual({ timeNs: 14n * SECOND, isAtEnd: false });
});

it("skips the ten years between two recordings, but no short silence", () => {
  const years = 315_000_000n * SECOND;
  const recorded = [{ fromNs: 0n, toNs: 5n * SECOND }, { fromNs: 6n * SECOND, toNs: 8n * SECOND }, { fromNs: years, toNs: years + SECOND }];
  const long = { ...state, span: { fromNs: 0n, toNs: years + SECOND }, recorded };
  expect(advanced({ ...long, timeNs: 5n * SECOND }, 500, 1).timeNs).toBe(5_500_000_000n);
  expect(advanced({ ...long, timeNs: 8n * SECOND }, 100, 1).timeNs).toBe(years);
});

it("keeps times within the span", () => {
  expect([-5n, 5n, 50n].map((timeNs) => within({ fromNs: 0n, toNs: 10n }, timeNs))).toEqual([0n, 5n, 10n]);
});
