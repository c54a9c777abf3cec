// Severity and grouping of the warnings of recordings and missions.
import { counted } from "./format";
import type { Tone } from "./tones";

export type Severity = "error" | "warning" | "info";

export interface Warning {
  /** The kind: a code of the server or of this app. */
  readonly code: string;
  readonly message: string;
  /** A topic or a location in a file; can be empty. */
  readonly where: string;
  /** The file or recording; empty for the mission. */
  readonly source: string;
  readonly fileId: string | null;
}

export interface WarningKind {
  readonly code: string;
  readonly severity: Severity;
  readonly title: string;
  readonly warnings: readonly Warning[];
}

export const severityTones: Readonly<Record<Severity, Tone>> = { error: "bad", warning: "attention", info: "plain" };
const ORDER: readonly Severity[] = ["error", "warning", "info"];

// Data is lost or wrong. The codes are those of docs/formats.md; any other code is a warning.
const ERRORS: ReadonlySet<string> = new Set([
  "bytes-lost", "bytes-corrupt", "unreadable", "data-lost", "damaged", "damaged-message", "json-damaged", "lines-damaged",
  "member-missing", "message-undecodable", "rows-unusable", "too-damaged", "too-late",
]);
// Often intended.
const INFOS: ReadonlySet<string> = new Set([
  "gaps-upper-bound", "member-unlisted", "metadata-unread", "more-problems", "silent-topic", "stamp-unit", "stamps-before-start",
]);

/** Returns the severity of a warning code. */
export function severityOf(code: string): Severity {
  if (ERRORS.has(code)) return "error";
  return INFOS.has(code) ? "info" : "warning";
}

/** Returns a code as words: `long-gap` is `Long gap`. */
export function titleOf(code: string): string {
  const words = code.replaceAll(/[-_.]+/g, " ").trim();
  return words.charAt(0).toUpperCase() + words.slice(1);
}

/** Returns warnings by kind: the most severe kinds first, then those with the most warnings. */
export function byKind(warnings: readonly Warning[]): readonly WarningKind[] {
  const kinds = new Map<string, Warning[]>();
  for (const warning of warnings) {
    const known = kinds.get(warning.code);
    if (known === undefined) kinds.set(warning.code, [warning]);
    else known.push(warning);
  }
  return [...kinds]
    .map(([code, all]) => ({ code, severity: severityOf(code), title: titleOf(code), warnings: all }))
    .sort((one, other) =>
      ORDER.indexOf(one.severity) - ORDER.indexOf(other.severity) || other.warnings.length - one.warnings.length || one.code.localeCompare(other.code),
    );
}

function distinct(values: readonly string[]): number {
  return new Set(values.filter((value) => value !== "")).size;
}

/** Returns where the warnings of a kind occur: `on 4 topics, in 3 files`. */
export function spreadOf({ warnings }: WarningKind): string {
  const topics = distinct(warnings.map(({ where }) => (where.startsWith("/") ? where : "")));
  const sources = distinct(warnings.map(({ source }) => source));
  return [topics > 0 ? `on ${counted(topics, "topic")}` : "", sources > 1 ? `in ${counted(sources, "file")}` : ""].filter((item) => item !== "").join(", ");
}
