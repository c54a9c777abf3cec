// Texts of checks and verdicts: chips, the mission's and the project's checks.
import type { components } from "@/api/schema";
import type { CellStatus, CheckCounts, Verdict } from "@/api/types";
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
  unchecked: { label: "Unchecked", why: "No checks were made, or some are still to be made and none has failed." },
};

export const statusTexts: Readonly<Record<CellStatus, Named>> = {
  error: { label: "Error", why: "The check failed." },
  warning: { label: "Warning", why: "The check gave a warning." },
  not_made: { label: "Not made", why: "The check could not be made. It counts as a warning." },
  accepted: { label: "Accepted", why: "A person accepted that the check fails. It does not count." },
  ok: { label: "Passed", why: "The check passed." },
  needs_content: { label: "Needs content", why: "The check reads the messages, and only the index was read. Until it is made, the mission is not good." },
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
  report: { label: "Content report", why: "An uploader or a run made it from the files, and sent the outcome." },
  action: { label: "Action", why: "A run of an action made it." },
};

const acceptanceEnds: Readonly<Record<components["schemas"]["AcceptanceEnd"], string>> = {
  withdrawn: "withdrawn",
  replaced: "replaced by a later one",
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
  reference: "Reference",
  leftOut: "Profiles not applied",
  leftOutProfile: (name: string, reason: string) => `${name}: ${reason}`,
  history: "Show history",
  acceptances: "Accepted checks",
  acceptanceOf: (check: string, topic: string | null) => (topic === null ? check : `${check} on ${topic}`),
  failures: (count: number) => counted(count, "failure"),
  actionOf: (name: string, version: number | null | undefined) => (typeof version === "number" ? `${name}@${version}` : name),
  acceptanceEnds,
  by: (name: string) => `by ${name}`,
  reports: "Reports of uploaders and runs",
  byRun: "run",
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
    acceptWhy: "What failed no longer counts in the verdict, until the files of the mission change. What fails later, on other topics or by other rules, counts. The audit log records who accepted it and why; people with a link to the mission can read the reason.",
    because: "Reason",
    becauseMissing: "Enter a reason.",
    allTopics: "Accept it on all topics on which it fails now",
    allPlaces: "All failures of this check are accepted, of whichever file or action.",
    acceptedNow: (name: string, failures: number) => `${counted(failures, "failure")} of ${name} accepted.`,
    withdraw: "Withdraw",
    withdrawn: (name: string) => `${name} counts again.`,
    notes: "Notes",
    noNotes: "No notes.",
    addNote: "Add note",
    note: "Note",
    removeNote: (name: string) => `Delete note by ${name}`,
  },
} as const;

export const matrixTexts = {
  label: "Checks of the missions",
  mission: "Mission",
  legend: "Statuses",
  cell: (name: string, status: string) => `${name}: ${status}`,
  notChecked: (name: string) => `${name}: not checked`,
  explained: "Details of the cell",
  hint: "Point at a cell, or move with the arrow keys, to see what was measured. Enter opens the mission.",
  more: (count: number) => `and ${formatCount(count)} more`,
  none: "No missions checked yet",
  noneWhy: "Each mission becomes a row, and each check a column, once the project has a checks.yaml.",
  noMissions: "No missions yet.",
} as const;

export const trendTexts = {
  title: "Verdicts over time",
  by: "Bars",
  steps: { week: "Weeks", day: "Days" },
  bar: (by: "week" | "day", day: string, what: string) => (by === "week" ? `Week of ${day}: ${what}` : `${day}: ${what}`),
  none: "no missions",
  empty: "No missions yet.",
  legend: "Verdicts",
} as const;

export const rulesTexts = {
  label: "checks.yaml",
  why: "The rules that all missions of this project are checked by. Saving checks every mission again from its index; no data is read.",
  readOnly: "Only people who can edit the project can change them.",
  none: "No checks.yaml yet",
  noneWhy: "Let klein write the first one from good missions on your machine, then send it here:",
  begin: "Write it here",
  starter: `version: 1
profiles:
  - name: every mission
    # when: {robot: anymal}
    topics:
      "/imu/*":
        rate: 200 Hz
        max_gap: 100ms
      "/camera/*":
        covers: 95%
        severity: warning
`,
  version: (number: number) => `Version ${number}`,
  save: "Save and check all missions",
  saved: (number: number) => `Version ${number} saved. The missions are being checked.`,
  removed: "checks.yaml removed.",
  reset: "Discard changes",
  dirty: "Unsaved changes.",
  willRemove: "Saving an empty text removes checks.yaml.",
  changedMeanwhile: "Someone else has saved another version. Discard your changes to load it.",
  at: (line: number, column: number) => `Line ${line}, column ${column}:`,
  goTo: "Go to the line",
  history: "Versions",
  current: "Current",
  removal: "Removed",
  againstCurrent: "Compare with the current version",
  restore: "Edit this version",
  noDifferences: "No differences.",
  differences: "Differences",
  skipped: (count: number) => counted(count, "unchanged line"),
  kinds: { same: "Unchanged:", added: "Added:", removed: "Removed:" },
  more: "Show more",
} as const;

export const projectTexts = {
  parts: { label: "Views of the checks", missions: "Missions", rules: "Rules", actions: "Actions" },
} as const;

export const projectActionTexts = {
  why: "These actions run by themselves, once on each mission that is due from now on, and again only when asked. Their results count in the verdicts.",
  readOnly: "Only people who can edit the project can add or remove actions.",
  none: "No actions yet",
  noneWhy: "An action can check what rules cannot, such as odometry against a reference.",
  command: "klein project actions add ACTION -p PROJECT --on complete",
  runs: { complete: "Runs when a mission is marked as complete.", idle: "Runs when the files of a mission have not changed for some time." },
  runsIdle: (time: string) => `Runs when the files of a mission have not changed for ${time}.`,
  actsFor: (name: string) => `Acts for ${name}`,
  actsForYou: "Its runs act for you, with your rights. Without them it no longer runs.",
  problem: (missions: number) => `Did not run on ${counted(missions, "mission")}:`,
  addTitle: "Add an action",
  add: "Add action",
  added: (name: string) => `${name} added.`,
  action: "Action",
  choose: "Choose an action",
  chooseOne: "Choose an action.",
  when: "Runs",
  triggers: { complete: "When a mission is marked as complete", idle: "When the files have not changed for some time" },
  idle: "Time without changes",
  minutes: "minutes",
  idleHint: "Of all files of the mission, with no upload under way.",
  idleWrong: "Enter a number of minutes, at most 30 days.",
  remove: (name: string) => `Remove ${name}`,
  removeTitle: (name: string) => `Remove ${name}?`,
  removeWhy: "It no longer runs by itself, and its results no longer count. Its runs stay.",
  removeIt: "Remove",
} as const;
