// Texts of checks and verdicts: chips, the mission's and the project's checks.
import type { components } from "@/api/schema";
import type { CheckCounts, CheckStatus, Verdict } from "@/api/types";
import { counted, formatCount } from "@/components/format";

interface Named {
  readonly label: string;
  readonly why: string;
}

export const verdictTexts: Readonly<Record<Verdict, Named>> = {
  good: { label: "Good", why: "All checks passed." },
  warnings: { label: "Warnings", why: "Some checks gave warnings, or could not be made." },
  bad: { label: "Bad", why: "Some checks failed." },
  outdated: { label: "Outdated", why: "Files, checks, or actions are newer than the results." },
  running: { label: "Checking", why: "Checks are running. The page updates automatically." },
  unchecked: { label: "Unchecked", why: "No checks were made." },
};

export const statusTexts: Readonly<Record<CheckStatus, Named>> = {
  error: { label: "Error", why: "The check failed." },
  warning: { label: "Warning", why: "The check gave a warning." },
  not_made: { label: "Not made", why: "The check could not be made. It counts as a warning." },
  ok: { label: "Passed", why: "The check passed." },
  needs_content: { label: "Needs content", why: "The check reads the messages, and only the index was read. It does not count." },
};

const counters: Readonly<Record<keyof CheckCounts, (count: number) => string>> = {
  error: (count) => counted(count, "error"),
  warning: (count) => counted(count, "warning"),
  not_made: (count) => `${formatCount(count)} not made`,
  ok: (count) => `${formatCount(count)} passed`,
  needs_content: (count) => `${formatCount(count)} need content`,
  accepted: (count) => `${formatCount(count)} accepted`,
};
const COUNTERS = ["error", "warning", "not_made", "accepted", "ok", "needs_content"] as const;

/** The numbers of checks in words, the worst first; nothing where there are none. */
export function countsText(counts: CheckCounts): string {
  return COUNTERS.flatMap((name) => (counts[name] > 0 ? [counters[name](counts[name])] : [])).join(", ");
}

const sources: Readonly<Record<components["schemas"]["CheckSource"], Named>> = {
  server: { label: "Index", why: "The server made it from the index of the recordings." },
  report: { label: "Content report", why: "The uploader made it from the files, and sent the outcome." },
  action: { label: "Action", why: "A run of an action made it." },
};

const acceptanceEnds: Readonly<Record<components["schemas"]["AcceptanceEnd"], string>> = {
  withdrawn: "withdrawn",
  files_changed: "ended because the files changed",
};

export const texts = {
  label: "Checks",
  columns: { status: "Status", check: "Check", value: "Value", where: "Location", source: "Source" },
  sources,
  filter: "Filter by name, topic, file, or message",
  statuses: "Status",
  allSources: "All sources",
  source: "Source",
  shown: (shown: number, all: number) => (shown === all ? counted(all, "check") : `${formatCount(shown)} of ${counted(all, "check")}`),
  noneMatch: "No matching checks.",
  limit: (limit: string) => `limit ${limit}`,
  accepted: "Accepted",
  acceptedBecause: (because: string) => `Accepted: ${because}`,
  notes: (count: number) => counted(count, "note"),
  rowName: (name: string, where: string) => (where === "" ? name : `${name} on ${where}`),

  none: "No checks yet",
  noneWhy: "A project’s checks.yaml says what good recordings look like: topics, rates, gaps, clocks, and content. Every mission is then checked after each upload.",
  noneCommand: "klein check FOLDER/ --checks checks.yaml",
  toRules: "Checks of the project",
  evaluated: "Checked",
  notYet: "Not checked yet.",
  byVersion: (number: number) => `by checks.yaml, version ${number}`,
  badSince: "Bad since",
  notCurrent: "These results are of earlier files or an earlier checks.yaml.",
  applied: "Profiles applied",
  noneApplied: "None",
  leftOut: "Profiles not applied",
  leftOutProfile: (name: string, reason: string) => `${name}: ${reason}`,
  history: "Show history",
  acceptances: "Accepted checks",
  acceptanceOf: (check: string, topic: string | null) => (topic === null ? `${check}, all topics` : `${check} on ${topic}`),
  acceptanceEnds,
  by: (name: string) => `by ${name}`,
  reports: "Reports of uploaders",
  reportIs: (checks: number, files: number) => `${counted(checks, "check")} of ${counted(files, "file")}`,
  depths: { index: "from the index", content: "from the content" },
  superseded: "no longer counts",

  detail: {
    value: "Value",
    limit: "Limit",
    topic: "Topic",
    file: "File",
    time: "Log time",
    source: "Source",
    run: "Run",
    openRun: "Open the run",
    accept: "Accept",
    acceptTitle: "Accept this check",
    acceptWhy: "It no longer counts in the verdict, until the files of the mission change. The audit log records who accepted it and why.",
    because: "Reason",
    becauseMissing: "Enter a reason.",
    allTopics: "Accept this check on all topics",
    acceptedNow: (name: string) => `${name} accepted.`,
    withdraw: "Withdraw",
    withdrawn: (name: string) => `${name} counts again.`,
    notes: "Notes",
    noNotes: "No notes.",
    addNote: "Add note",
    note: "Note",
    removeNote: (name: string) => `Delete note by ${name}`,
  },
} as const;
