import { expect, it } from "vitest";
import { aligned, bytesToReadAll, partAround, partsToDetail, segmentOf, unreadParts, unreadUntil, valueAt, withDetail, type Segment } from "./curves";
import type { SourceFile } from "./sources";

const file: SourceFile = { id: "f", path: "a.mcap", format: "mcap", size_bytes: 1, span: { fromNs: 0n, toNs: 100n } };

function segment(fromNs: bigint, toNs: bigint, more: Partial<Segment> = {}): Segment {
  return { fileId: "f", fromNs, toNs, seconds: [], values: [], messages: 0, isWhole: true, topicBytes: 0, unstamped: 0, ...more };
}

it("names the parts of a file that were not read", () => {
  expect(unreadParts(file, [])).toEqual([file.span]);
  expect(unreadParts(file, [segment(50n, 60n), segment(0n, 20n), segment(0n, 100n, { fileId: "g" })])).toEqual([
    { fromNs: 21n, toNs: 49n },
    { fromNs: 61n, toNs: 100n },
  ]);
  expect(unreadParts(file, [segment(0n, 100n)])).toEqual([]);
});

it("reads around a time only within the unread part that the time is in", () => {
  expect(partAround([{ fromNs: 21n, toNs: 49n }], 30n)).toEqual({ fromNs: 21n, toNs: 49n });
  expect(partAround([{ fromNs: 21n, toNs: 49n }], 50n)).toBeNull();
  const hour = { fromNs: 0n, toNs: 3_600_000_000_000n };
  expect(partAround([hour], 60_000_000_000n)).toEqual({ fromNs: 58_000_000_000n, toNs: 75_000_000_000n });
});

it("covers no more than what was read where the limit was reached", () => {
  const curves = { seconds: [0, 1], values: [[5, 6]], messages: 2, isWhole: true, wholeBytes: 99, topicBytes: 999, damaged: [], untilNs: 40n, unstamped: 0 };
  expect(segmentOf("f", file.span, curves, 2)).toMatchObject({ fromNs: 0n, toNs: 40n, seconds: [2, 3], topicBytes: 999 });
  expect(segmentOf("f", file.span, { ...curves, untilNs: 100n }, 2)).toMatchObject({ toNs: 100n });
});

it("names what a topic needs in the files with unread parts, and estimates it for those that were not opened", () => {
  const files = ["f", "g", "h"].map((id, number): SourceFile => ({ ...file, id, size_bytes: 1_000 * (number + 1) }));
  const around = segment(40n, 50n, { topicBytes: 100 });
  expect(bytesToReadAll(files, [around, segment(60n, 61n, { topicBytes: 100 })])).toBe(100 + 200 + 300);
  expect(bytesToReadAll(files, [around, segment(0n, 100n, { fileId: "g", topicBytes: 800 })])).toBe(100 + 900);
  expect(bytesToReadAll(files, files.map(({ id }) => segment(0n, 100n, { fileId: id, topicBytes: 5 })))).toBe(0);
  expect(bytesToReadAll(files, [])).toBe(0);
});

it("keeps the value of a message where another one at the same time has none", () => {
  const segments = [segment(0n, 20n, { seconds: [0, 0, 1, 1], values: [[null, null, 5, null]] })];
  expect(aligned([{ curves: 1, segments }]).values).toEqual([[null, 5]]);
});

it("counts what remains of a segment whose beginning is read again", () => {
  const whole = segment(0n, 100n, { isWhole: false, messages: 50, unstamped: 5 });
  const segments = withDetail([whole], segment(0n, 20n, { messages: 10, unstamped: 2 }), Number);
  expect(segments.map(({ fromNs, messages, unstamped }) => [fromNs, messages, unstamped])).toEqual([
    [21n, 40, 3],
    [0n, 10, 2],
  ]);
});

it("puts curves of several topics side by side, and breaks one between segments that are apart", () => {
  const fast = [segment(60n, 80n, { seconds: [6, 7], values: [[60, 70]] }), segment(0n, 20n, { seconds: [0, 1], values: [[0, 10]] })];
  const slow = [segment(0n, 100n, { seconds: [0, 6.5], values: [[1, 2], [null, 4]] })];
  const { seconds, values } = aligned([{ curves: 1, segments: fast }, { curves: 2, segments: slow }]);
  expect(seconds).toEqual([0, 1, 6 - 1e-6, 6, 6.5, 7]);
  expect(values[0]).toEqual([0, 10, null, 60, undefined, 70]);
  expect(values[1]).toEqual([1, undefined, undefined, undefined, 2, undefined]);
  expect(values[2]).toEqual([null, undefined, undefined, undefined, 4, undefined]);
});

it("does not break a curve between segments that touch", () => {
  const segments = [segment(0n, 20n, { seconds: [0, 2], values: [[1, 2]] }), segment(21n, 40n, { seconds: [3], values: [[3]] })];
  expect(aligned([{ curves: 1, segments }]).values).toEqual([[1, 2, 3]]);
});

it("returns the value that is valid at a time", () => {
  const curves = { seconds: [0, 1, 2], values: [[10, undefined, 12], [null, 21, undefined]] };
  expect([-1, 0, 1.5, 2, 9].map((second) => valueAt(curves, 0, second))).toEqual([null, 10, 10, 12, 12]);
  expect([0, 1, 5].map((second) => valueAt(curves, 1, second))).toEqual([null, 21, 21]);
});

it("returns no value from before an unread part", () => {
  const unread = [{ fromNs: 21n, toNs: 49n }, { fromNs: 61n, toNs: 100n }];
  expect([0n, 21n, 30n, 55n, 61n, 200n].map((timeNs) => unreadUntil(unread, timeNs))).toEqual([null, 49n, 49n, 49n, 100n, 100n]);
  const curves = { seconds: [0, 20, 55], values: [[10, 11, 12]] };
  expect(valueAt(curves, 0, 30, 49)).toBeNull();
  expect(valueAt(curves, 0, 52, 49)).toBeNull();
  expect(valueAt(curves, 0, 56, 49)).toBe(12);
});

it("reads again what is zoomed in of a part that is drawn by extremes", () => {
  const thinned = segment(0n, 100n, { isWhole: false });
  expect(partsToDetail("f", [thinned], { fromNs: 90n, toNs: 120n })).toEqual([{ fromNs: 90n, toNs: 100n }]);
  expect(partsToDetail("f", [thinned], { fromNs: 10n, toNs: 70n })).toEqual([]); // hardly more detail
  expect(partsToDetail("f", [segment(0n, 100n)], { fromNs: 10n, toNs: 20n })).toEqual([]);
  expect(partsToDetail("g", [thinned], { fromNs: 10n, toNs: 20n })).toEqual([]);
});

it("puts what was read again into its place", () => {
  const thinned = segment(0n, 100n, { seconds: [0, 10, 20, 30, 100], values: [[0, 1, 2, 3, 10]], isWhole: false, messages: 1000 });
  const detail = segment(10n, 29n, { seconds: [10, 11, 29], values: [[1, 1.1, 2.9]], messages: 3 });
  const segments = withDetail([thinned], detail, Number);
  expect(segments.map(({ fromNs, toNs, seconds, messages }) => [fromNs, toNs, seconds, messages])).toEqual([
    [0n, 9n, [0], 997],
    [30n, 100n, [30, 100], 0],
    [10n, 29n, [10, 11, 29], 3],
  ]);
  expect(aligned([{ curves: 1, segments }])).toEqual({ seconds: [0, 10, 11, 29, 30, 100], values: [[0, 1, 1.1, 2.9, 3, 10]] });
  expect(withDetail([segment(0n, 9n)], detail, Number)).toHaveLength(2);
});
