import { describe, expect, it } from "vitest";
import { counted, formatAgo, formatDuration, formatHours, formatRate, formatShare, formatSize, formatUtc } from "./format";

const NS = 1_000_000_000;

describe("sizes, as the command line writes them", () => {
  it.each([
    [0, "0 B"], [999, "999 B"], [1000, "1.0 kB"], [1_234_567, "1.2 MB"], [5e9, "5.0 GB"], [2.5e12, "2.5 TB"], [3e15, "3000.0 TB"],
  ])("%d bytes", (bytes, text) => expect(formatSize(bytes)).toBe(text));
});

describe("spans", () => {
  it.each([
    [0, "0 s"], [0.25 * NS, "0.250 s"], [6 * NS, "6 s"], [12.34 * NS, "12.3 s"], [65 * NS, "1 min 05 s"], [3599.6 * NS, "1 h 00 min"], [8040 * NS, "2 h 14 min"],
    [100 * 3600 * NS, "4.2 days"], [102_492 * 3600 * NS, "11.7 years"],
  ])("%d ns", (nanoseconds, text) => expect(formatDuration(nanoseconds)).toBe(text));
});

describe("sums of recorded time", () => {
  it.each([[8040 * NS, "2 h 14 min"], [1204 * 3600 * NS, "1,204 h"]])("%d ns", (nanoseconds, text) => expect(formatHours(nanoseconds)).toBe(text));
});

describe("counts and shares", () => {
  it("keeps one apart from many", () => {
    expect(counted(1, "file")).toBe("1 file");
    expect(counted(12_345, "file")).toBe("12,345 files");
    expect(counted(2, "entry", "entries")).toBe("2 entries");
  });
  it("is never all while something is missing", () => {
    expect(formatShare(999_999, 1_000_000)).toBe("99 %");
    expect(formatShare(5, 5)).toBe("100 %");
    expect(formatShare(0, 0)).toBe("0 %");
  });
  it("writes rates", () => expect(formatRate(12.5)).toBe("12.50 Hz"));
});

describe("times", () => {
  const now = new Date("2026-05-01T12:00:00Z");
  it.each([
    ["2026-05-01T11:59:58Z", "2 seconds ago"], ["2026-05-01T09:00:00Z", "3 hours ago"], ["2026-04-30T12:00:00Z", "yesterday"],
    ["2026-05-01T13:30:00Z", "in 1 hour"],
  ])("%s", (at, text) => expect(formatAgo(new Date(at), now)).toBe(text));
  it("says what is no time", () => expect(formatUtc(new Date("nonsense"))).toBe("–"));
});
