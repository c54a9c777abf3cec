// Severity and grouping of the warnings of recordings and missions.
import { counted } from "./format";
import type { Tone } from "./tones";

export type Severity = "error" | "warning" | "info";

export interface Problem {
  /** The kind: a code of the server's, or a word of ours. */
  readonly code: string;
  readonly message: string;
  /** A topic, or a place in a file; empty where there is none. */
  readonly where: string;
  /** What the problem is in: a file or a recording; empty for the mission. */
  readonly source: string;
  readonly fileId: string | null;
}

export interface ProblemKind {
  readonly code: string;
  readonly severity: Severity;
  readonly title: string;
  readonly problems: readonly Problem[];
}

export const severityTones: Readonly<Record<Severity, Tone>> = { error: "bad", warning: "attention", info: "plain" };
const ORDER: readonly Severity[] = ["error", "warning", "info"];

// Data is lost, or wrong. The codes are those of docs/formats.md; any other code is a warning.
const ERRORS: ReadonlySet<string> = new Set([
  "bytes-lost", "bytes-corrupt", "unreadable", "data-lost", "damaged", "damaged-message", "json-damaged", "lines-damaged",
  "member-missing", "message-undecodable", "rows-unusable", "too-damaged", "too-late",
]);
// Worth knowing, and often intended.
const INFOS: ReadonlySet<string> = new Set([
  "gaps-upper-bound", "member-unlisted", "metadata-unread", "more-problems", "silent-topic", "stamp-unit", "stamps-before-start",
]);

/** Returns how severe a kind of problem is. */
export function severityOf(code: string): Severity {
  if (ERRORS.has(code)) return "error";
  return INFOS.has(code) ? "info" : "warning";
}

/** Returns a code as words: `long-gap` is `Long gap`. */
export function titleOf(code: string): string {
  const words = code.replaceAll(/[-_.]+/g, " ").trim();
  return words.charAt(0).toUpperCase() + words.slice(1);
}

/** Returns problems by kind: the most severe kinds first, then those with the most problems. */
export function byKind(problems: readonly Problem[]): readonly ProblemKind[] {
  const kinds = new Map<string, Problem[]>();
  for (const problem of problems) {
    const known = kinds.get(problem.code);
    if (known === undefined) kinds.set(problem.code, [problem]);
    else known.push(problem);
  }
  return [...kinds]
    .map(([code, all]) => ({ code, severity: severityOf(code), title: titleOf(code), problems: all }))
    .sort((one, other) =>
      ORDER.indexOf(one.severity) - ORDER.indexOf(other.severity) || other.problems.length - one.problems.length || one.code.localeCompare(other.code),
    );
}

function distinct(values: readonly string[]): number {
  return new Set(values.filter((value) => value !== "")).size;
}

/** Returns over what a kind of problem is spread: `on 4 topics, in 3 files`. */
export function spreadOf({ problems }: ProblemKind): string {
  const topics = distinct(problems.map(({ where }) => (where.startsWith("/") ? where : "")));
  const sources = distinct(problems.map(({ source }) => source));
  return [topics > 0 ? `on ${counted(topics, "topic")}` : "", sources > 1 ? `in ${counted(sources, "file")}` : ""].filter((item) => item !== "").join(", ");
}
