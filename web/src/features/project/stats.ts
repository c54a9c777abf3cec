// Statistics as they are shown and saved.
import type { Overview, StatsRow } from "./queries";
import { formatCount, formatHours, formatSize } from "@/components/format";
import { texts as all } from "@/texts/project";

const texts = all.stats;
const NS_PER_H = 3.6e12;
export const MEASURES = ["duration_ns", "size_bytes", "files", "missions", "messages"] as const;
export type Measure = (typeof MEASURES)[number];

export interface Bar {
  readonly key: string;
  readonly label: string;
  readonly row: StatsRow;
  /** Of the longest bar, from 0 to 1. */
  readonly share: number;
}

/** Returns a number of a measure as people read it. */
export function shownMeasure(measure: Measure, row: StatsRow): string {
  if (measure === "size_bytes") return formatSize(row.size_bytes);
  if (measure === "duration_ns") return formatHours(row.duration_ns);
  return formatCount(row[measure]);
}

/** Returns the bars of an overview; what has no value comes last. */
export function barsOf(overview: Overview, measure: Measure): readonly Bar[] {
  const named = overview.buckets.map(({ value, low, high, stats }) => {
    const isRange = typeof low === "number" && typeof high === "number";
    const nothing = overview.by === "month" ? texts.noMonth : texts.none;
    const label = isRange ? texts.range(low, high, overview.unit ?? "") : (value ?? nothing);
    return { label, row: stats, isNothing: !isRange && value === null };
  });
  const rows = [
    ...named.filter((each) => !each.isNothing),
    ...(overview.other === null ? [] : [{ label: texts.other, row: overview.other }]),
    ...named.filter((each) => each.isNothing),
  ];
  const most = rows.reduce((high, { row }) => Math.max(high, row[measure]), 0);
  return rows.map(({ label, row }, at) => ({ key: `${at} ${label}`, label, row, share: most === 0 ? 0 : row[measure] / most }));
}

function cell(text: string): string {
  // What a table program would take for a formula is marked as text.
  const plain = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\n\r]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
}

/** Returns an overview as CSV. */
export function csvOf(bars: readonly Bar[], total: StatsRow): string {
  const line = (label: string, row: StatsRow) =>
    [cell(label), row.missions, row.files, row.recordings, row.duration_ns / NS_PER_H, row.size_bytes, row.messages].join(",");
  return [texts.columns.join(","), ...bars.map(({ label, row }) => line(label, row)), line(texts.total, total), ""].join("\n");
}
