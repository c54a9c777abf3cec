import { expect, it } from "vitest";
import { roughSegments } from "./rough_curves";
import type { SourceFile } from "./sources";

const file: SourceFile = { id: "f", path: "a.mcap", format: "mcap", size_bytes: 1, span: { fromNs: 0n, toNs: 39n } };
const secondsOf = (timeNs: bigint): number => Number(timeNs);
const nothing = { messages: 0, isWhole: true, topicBytes: 0, unstamped: 0, seconds: [], values: [] };

it("draws both extremes of each bin, in turn, and breaks where a bin has no number", () => {
  const series = {
    messagesPerBin: 5,
    firstNs: new BigInt64Array([0n, 10n, 20n, 30n]),
    lastNs: new BigInt64Array([9n, 19n, 29n, 39n]),
    fields: [{ low: [0, 1, NaN, 3], high: [5, 6, NaN, 8] }, null],
    readSpans: new BigInt64Array(),
  };
  const [segment] = roughSegments([{ file, series }], [], secondsOf);
  expect(segment?.seconds).toEqual([0, 9, 10, 19, 20, 29, 30, 39]);
  expect(segment?.values).toEqual([[0, 5, 6, 1, null, null, 8, 3], Array.from({ length: 8 }, () => null)]);
  expect(segment?.isWhole).toBe(false);
});

it("draws a message as one point, and only in the parts that were not read", () => {
  const times = new BigInt64Array([0n, 10n, 20n, 30n]);
  const series = { messagesPerBin: 1, firstNs: times, lastNs: times, fields: [{ low: [1, 2, 3, 4], high: [1, 2, 3, 4] }], readSpans: new BigInt64Array() };
  const segments = roughSegments([{ file, series }], [{ ...nothing, fileId: "f", fromNs: 10n, toNs: 25n }], secondsOf);
  expect(segments.map(({ fromNs, toNs, seconds, values }) => [fromNs, toNs, seconds, values])).toEqual([
    [0n, 9n, [0], [[1]]],
    [26n, 39n, [30], [[4]]],
  ]);
});

it("breaks where nothing was read between two parts, and draws a bin of several parts at one place", () => {
  const series = {
    messagesPerBin: 5,
    firstNs: new BigInt64Array([0n, 40_000n, 300_000n]),
    lastNs: new BigInt64Array([30_000n, 200_000n, 390_000n]),
    fields: [{ low: [0, 1, 2], high: [5, 6, 7] }],
    readSpans: new BigInt64Array([0n, 90_000n, 200_000n, 390_000n]),
  };
  const [segment] = roughSegments([{ file: { ...file, span: { fromNs: 0n, toNs: 390_000n } }, series }], [], secondsOf);
  expect(segment?.seconds).toEqual([0, 30_000, 40_000, 41_000, 170_500, 300_000, 390_000]);
  expect(segment?.values[0]).toEqual([0, 5, 6, 1, null, 2, 7]);
});
