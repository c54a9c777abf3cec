// Curves from the previews of recordings, where the messages themselves were not read.
import { type Segment, unreadParts } from "./curves";
import type { SourceFile } from "./sources";
import type { Span } from "@/recordings/formats/recording";
import type { PreviewSeries } from "@/recordings/preview_file";

/** The bins of a topic in one file. */
export interface FileSeries {
  readonly file: SourceFile;
  readonly series: PreviewSeries;
}

/** Returns segments of the parts that were not read; `secondsOf` returns the place of a log time on the axis. */
export function roughSegments(previewed: readonly FileSeries[], read: readonly Segment[], secondsOf: (timeNs: bigint) => number): Segment[] {
  return previewed.flatMap(({ file, series }) => unreadParts(file, read).map((part) => roughSegment(file.id, part, series, secondsOf)));
}

/** What is drawn of a bin at a time; without a bin, the curve is broken. */
interface RoughPoint {
  readonly second: number;
  readonly bin: number | null;
  readonly isLow: boolean;
}

/** Both extremes of a bin of several parts are drawn at one place. */
const STROKE_NS = 1_000n;

/** Of each bin, both extremes. Which of them came first is not known: they alternate, so that a slow curve has no jags. */
function roughSegment(fileId: string, part: Span, { firstNs, lastNs, messagesPerBin, fields, readSpans }: PreviewSeries, secondsOf: (timeNs: bigint) => number): Segment {
  const points: RoughPoint[] = [];
  let lastPart = 0;
  const put = (bin: number, timeNs: bigint, isLow: boolean, ofPart: number): void => {
    if (timeNs < part.fromNs || timeNs > part.toNs) return;
    const second = secondsOf(timeNs);
    const last = points.at(-1);
    if (last?.second === second) return;
    if (last !== undefined && ofPart !== lastPart) points.push({ second: (last.second + second) / 2, bin: null, isLow });
    lastPart = ofPart;
    points.push({ second, bin, isLow });
  };
  for (let bin = 0; bin < firstNs.length; bin += 1) {
    const [first, last] = [firstNs[bin] ?? 0n, lastNs[bin] ?? 0n];
    const [partOfFirst, partOfLast] = [partAt(readSpans, first), partAt(readSpans, last)];
    put(bin, first, bin % 2 === 0, partOfFirst);
    if (messagesPerBin > 1) put(bin, partOfFirst === partOfLast ? last : first + STROKE_NS, bin % 2 !== 0, partOfFirst);
  }
  const values = fields.map((field) => points.map(({ bin, isLow }) => (bin === null ? null : numberOrNull((isLow ? field?.low : field?.high)?.[bin]))));
  const seconds = points.map(({ second }) => second);
  return { ...part, fileId, seconds, values, messages: 0, isWhole: false, topicBytes: 0, unstamped: 0 };
}

/** Returns the number of the part that a time is in, or after which it comes. */
function partAt(spans: BigInt64Array, timeNs: bigint): number {
  let [low, high] = [0, spans.length / 2];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((spans[2 * middle] ?? 0n) <= timeNs) low = middle + 1;
    else high = middle;
  }
  return low;
}

function numberOrNull(value: number | undefined): number | null {
  return value === undefined || !Number.isFinite(value) ? null : value;
}
