// Display of checks: values with units, filters, order, and what belongs to a check.
import type { Acceptance, Check, Note } from "./queries";
import type { CellStatus, CheckCounts, CheckStatus } from "@/api/types";
import { dateOfNs, formatSize, formatUtc } from "@/components/format";

/** The statuses, worst first. */
export const STATUSES = ["error", "warning", "not_made", "needs_content", "ok"] as const satisfies readonly CheckStatus[];
/** How checks count, worst first: accepted ones apart. */
export const CATEGORIES = ["error", "warning", "not_made", "needs_content", "accepted", "ok"] as const satisfies readonly CellStatus[];
export const SOURCES = ["server", "report", "action"] as const satisfies readonly Check["source"][];

const LARGE = 10_000;
const small = new Intl.NumberFormat("en-GB", { maximumSignificantDigits: 5 });
const large = new Intl.NumberFormat("en-GB", { maximumFractionDigits: 0 });

/** Returns a number with its unit; empty where there is none. */
export function measured(value: number | null | undefined, unit: string | null | undefined): string {
  if (value === null || value === undefined) return "";
  if (unit === "B") return formatSize(value);
  const number = (Math.abs(value) < LARGE ? small : large).format(value);
  return unit ? `${number} ${unit}` : number;
}

/** Returns what identifies a check among those of its mission, and is stable when they are made again. */
export function keyOf({ name, topic, file, source, action }: Check): string {
  return [name, topic ?? "", file ?? "", source, action ?? ""].join("|");
}

/** Returns where a check applies, as text: its topic, else its file. */
export function whereOf({ topic, file }: Check): string {
  return topic ?? file ?? "";
}

export function timeOf({ time_ns: time }: Check): string {
  return typeof time === "number" ? formatUtc(dateOfNs(time)) : "";
}

/** Returns how many checks failed or could not be made. */
export function failedCount({ error, warning, not_made: notMade }: CheckCounts): number {
  return error + warning + notMade;
}

/** Returns whether a check failed or could not be made, so that a person can accept it. */
export function canBeAccepted({ status, acceptance_id: acceptance }: Check): boolean {
  return !acceptance && status !== "ok" && status !== "needs_content";
}

export interface CheckFilter {
  readonly text: string;
  /** None means all. */
  readonly statuses: readonly string[];
  /** Empty means all. */
  readonly source: string;
}

/** Returns what has a check with the worst first, else in its order. */
export function worstFirst<Row extends { readonly check: { readonly status: CheckStatus } }>(rows: readonly Row[]): readonly Row[] {
  return STATUSES.flatMap((status) => rows.filter((row) => row.check.status === status));
}

/** Returns how a check counts. */
export function countsAs({ status, acceptance_id: acceptance }: Check): CellStatus {
  return acceptance ? "accepted" : status;
}

/** Returns the checks that match a filter, in their order, but accepted ones behind those that failed. */
export function filtered(checks: readonly Check[], { text, statuses, source }: CheckFilter): readonly Check[] {
  const words = text.toLowerCase().split(/\s+/).filter((word) => word !== "");
  const matching = checks.filter((check) => {
    if (source !== "" && check.source !== source) return false;
    if (statuses.length > 0 && !statuses.includes(countsAs(check))) return false;
    const content = [check.name, check.topic, check.file, check.action, check.message].join(" ").toLowerCase();
    return words.every((word) => content.includes(word));
  });
  const isAccepted = (check: Check) => countsAs(check) === "accepted";
  const failed = matching.filter((check) => canBeAccepted(check));
  return [...failed, ...matching.filter(isAccepted), ...matching.filter((check) => !canBeAccepted(check) && !isAccepted(check))];
}

/** Returns how many checks there are of each status, and accepted ones; only of those that occur, worst first. */
export function categories(checks: readonly Check[]): readonly { readonly category: CellStatus; readonly count: number }[] {
  const counts = new Map<CellStatus, number>();
  for (const check of checks) counts.set(countsAs(check), (counts.get(countsAs(check)) ?? 0) + 1);
  return CATEGORIES.flatMap((category) => {
    const count = counts.get(category);
    return count === undefined ? [] : [{ category, count }];
  });
}

/** Returns the acceptance that applies to a check. */
export function acceptanceOf(check: Check, acceptances: readonly Acceptance[]): Acceptance | undefined {
  return acceptances.find(({ id }) => id === check.acceptance_id);
}

/** Returns the notes on a check: on its topic, or on all topics. */
export function notesOf(check: Check, notes: readonly Note[]): readonly Note[] {
  return notes.filter(({ check: name, topic }) => name === check.name && (topic === null || topic === (check.topic ?? null)));
}
