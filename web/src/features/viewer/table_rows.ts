// Messages of a topic as rows: how much is read around the play head, the columns, and CSV.
import { fieldTree, stepsOf, valueAt, type FieldNode } from "@/recordings/decoding/fields";
import type { Span } from "@/recordings/formats/recording";
import type { PlainValue } from "@/recordings/products/plain_value";
import { leaves, quoted, shortNumber } from "@/features/file/viewer/plot";

export interface TableRow {
  readonly timeNs: bigint;
  readonly value: PlainValue;
}

/** Rows before and behind the play head. */
export const ROWS_BEFORE = 30;
export const ROWS_BEHIND = 60;
const MIN_NS = 50_000_000;
const MAX_NS = 3_600_000_000_000;
const UNKNOWN_PERIOD_NS = 1e9;

/** Returns the time around the play head that has about as many messages as there are rows. */
export function windowAround(timeNs: bigint, span: Span, count: number | null): Span {
  const periodNs = count === null || count < 2 ? UNKNOWN_PERIOD_NS : Number(span.toNs - span.fromNs) / (count - 1);
  const length = (rows: number): bigint => BigInt(Math.round(Math.min(MAX_NS, Math.max(MIN_NS, rows * periodNs))));
  return { fromNs: timeNs - length(ROWS_BEFORE), toNs: timeNs + length(ROWS_BEHIND) };
}

/** Returns the place of the last row at or before a time; -1 where all are later. */
export function validPlace(rows: readonly TableRow[], timeNs: bigint): number {
  return rows.findLastIndex((row) => row.timeNs <= timeNs);
}

/** Returns the rows that are shown around a time. */
export function rowsAround(rows: readonly TableRow[], timeNs: bigint): readonly TableRow[] {
  const place = validPlace(rows, timeNs);
  return rows.slice(Math.max(0, place - ROWS_BEFORE), place + 1 + ROWS_BEHIND);
}

/** Returns the fields of a message that can be columns. */
export function offeredColumns(value: PlainValue): FieldNode[] {
  return fieldTree(value, (inner) => inner === null || ["number", "boolean", "string"].includes(typeof inner));
}

const LATER = /(^|\.)(header|stamp|timestamp|seq)(\.|$)|covariance/;
const DEFAULT_COLUMNS = 6;
export const MAX_COLUMNS = 24;

/** Returns the columns: the selected ones that exist, else the first that are no header. */
export function columnsOf(offered: readonly FieldNode[], selected: readonly string[]): string[] {
  const all = leaves(offered);
  const available = selected.filter((field) => all.includes(field));
  if (available.length > 0) return available.slice(0, MAX_COLUMNS);
  const plain = all.filter((field) => !LATER.test(field));
  return (plain.length > 0 ? plain : all).slice(0, DEFAULT_COLUMNS);
}

/** Returns the value of a column; undefined where the message does not have it. */
export function cellOf({ value }: TableRow, column: string): PlainValue | undefined {
  return valueAt(value, stepsOf(column) ?? []) as PlainValue | undefined;
}

/** Returns a cell as text; `isExact` has every digit. */
export function cellText(cell: PlainValue | undefined, isExact = false): string {
  if (cell === undefined || cell === null) return "";
  if (typeof cell === "number" && !isExact && Number.isFinite(cell)) return shortNumber(cell);
  return typeof cell === "object" ? "" : String(cell);
}

/** Returns rows as CSV: the log time in nanoseconds, then the columns with every digit. */
export function rowsCsv(rows: readonly TableRow[], columns: readonly string[]): string {
  const lines = rows.map((row) => [row.timeNs.toString(), ...columns.map((column) => cellText(cellOf(row, column), true))]);
  return [["log_time_ns", ...columns], ...lines].map((cells) => cells.map(quoted).join(",")).join("\n") + "\n";
}
