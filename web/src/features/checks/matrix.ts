// The matrix of missions and checks, and the verdicts over time: columns, keyboard navigation, bars.
import { STATUSES } from "./checks";
import type { Check, MatrixRow, Trend, TrendStep } from "./queries";
import type { Verdict } from "@/api/types";
import { rowAfter } from "@/components/table";

/** Returns the names of all checks of some rows: in the order of the first page, then what later pages add. */
export function columnsOf(rows: readonly MatrixRow[]): readonly string[] {
  return [...new Set(rows.flatMap(({ names }, at) => (rows[at - 1]?.names === names ? [] : names)))];
}

/** A cell of the matrix; column 0 is the mission. */
export interface Cell {
  readonly row: number;
  readonly column: number;
}

/** Returns the cell that a key leads to; null for keys that lead nowhere. */
export function cellAfter(key: string, { row, column }: Cell, rows: number, columns: number, page: number, isControl: boolean): Cell | null {
  if (rows === 0) return null;
  const clamped = (at: number) => Math.max(0, Math.min(columns - 1, at));
  if (key === "ArrowRight") return { row, column: clamped(column + 1) };
  if (key === "ArrowLeft") return { row, column: clamped(column - 1) };
  if (key === "Home") return { row: isControl ? 0 : row, column: 0 };
  if (key === "End") return { row: isControl ? rows - 1 : row, column: clamped(columns - 1) };
  const next = rowAfter(key, row, rows, page);
  return next === null ? null : { row: next, column };
}

/** Returns the checks of a name that count most: the worst ones, without those that people accepted unless there are no others. */
export function worstOf(checks: readonly Check[], name: string): readonly Check[] {
  const named = checks.filter((check) => check.name === name);
  const counting = named.filter((check) => !check.acceptance_id);
  const candidates = counting.length > 0 ? counting : named;
  const worst = STATUSES.find((status) => candidates.some((check) => check.status === status));
  return candidates.filter((check) => check.status === worst);
}

export const VERDICTS = ["bad", "warnings", "outdated", "running", "good", "unchecked"] as const satisfies readonly Verdict[];

export interface Segment {
  readonly verdict: Verdict;
  readonly count: number;
  /** Of the tallest bar, from 0 to 1. */
  readonly share: number;
}

export interface TrendBar {
  /** The first day, as ISO date. */
  readonly start: string;
  readonly total: number;
  /** Worst first; only verdicts that occur. */
  readonly segments: readonly Segment[];
}

const DAY_MS = 86_400_000;
const STEP_DAYS: Readonly<Record<TrendStep, number>> = { day: 1, week: 7 };
/** The number of bars shown at most; earlier ones are left out. */
export const MAX_BARS = 53;

/** Returns a bar for each day or week from the first to the last one, including those without missions; the latest `MAX_BARS`. */
export function barsOf({ by, buckets }: Trend): readonly TrendBar[] {
  const known = new Map(buckets.map(({ start, verdicts }) => [start, verdicts]));
  const days = buckets.map(({ start }) => Date.parse(start) / DAY_MS).sort((one, other) => one - other);
  const [first, last] = [days[0], days.at(-1)];
  if (first === undefined || last === undefined) return [];
  const step = STEP_DAYS[by];
  const starts: string[] = [];
  for (let at = Math.max(first, last - (MAX_BARS - 1) * step); at <= last; at += step) starts.push(new Date(at * DAY_MS).toISOString().slice(0, 10));
  const totalOf = (start: string) => Object.values(known.get(start) ?? {}).reduce((sum, count) => sum + count, 0);
  const tallest = Math.max(1, ...starts.map(totalOf));
  return starts.map((start) => ({
    start,
    total: totalOf(start),
    segments: VERDICTS.flatMap((verdict) => {
      const count = known.get(start)?.[verdict] ?? 0;
      return count === 0 ? [] : [{ verdict, count, share: count / tallest }];
    }),
  }));
}
