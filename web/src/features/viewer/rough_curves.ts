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

/** Of each bin, both extremes. Which of them came first is not known: they alternate, so that a slow curve has no jags. */
function roughSegment(fileId: string, part: Span, { firstNs, lastNs, messagesPerBin, fields }: PreviewSeries, secondsOf: (timeNs: bigint) => number): Segment {
  const points: { readonly second: number; readonly bin: number; readonly isLow: boolean }[] = [];
  const put = (bin: number, timeNs: bigint | undefined, isLow: boolean): void => {
    if (timeNs === undefined || timeNs < part.fromNs || timeNs > part.toNs) return;
    const second = secondsOf(timeNs);
    if (points.at(-1)?.second !== second) points.push({ second, bin, isLow });
  };
  for (let bin = 0; bin < firstNs.length; bin += 1) {
    put(bin, firstNs[bin], bin % 2 === 0);
    if (messagesPerBin > 1) put(bin, lastNs[bin], bin % 2 !== 0);
  }
  const values = fields.map((field) => points.map(({ bin, isLow }) => numberOrNull((isLow ? field?.low : field?.high)?.[bin])));
  const seconds = points.map(({ second }) => second);
  return { ...part, fileId, seconds, values, messages: 0, isWhole: false, wholeBytes: 0, isCut: false };
}

function numberOrNull(value: number | undefined): number | null {
  return value === undefined || !Number.isFinite(value) ? null : value;
}
