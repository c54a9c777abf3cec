// The words of runs: of their states and ends, of the list and of a run's page.
import type { components } from "@/api/schema";
import type { RunState } from "@/api/types";
import { counted, formatSize } from "@/components/format";

type EndReason = components["schemas"]["EndReason"];
type Severity = components["schemas"]["Severity"];

interface Named {
  readonly label: string;
  readonly why: string;
}

export const stateTexts: Readonly<Record<RunState, Named>> = {
  queued: { label: "Queued", why: "It waits for a runner." },
  preparing: { label: "Preparing", why: "A runner fetches its image and its files." },
  running: { label: "Running", why: "Its command runs." },
  collecting: { label: "Collecting", why: "What it left is being kept." },
  done: { label: "Done", why: "It ended well." },
  failed: { label: "Failed", why: "It did not end well; its page says why." },
  cancelled: { label: "Cancelled", why: "Somebody ended it." },
};

export const reasonTexts: Readonly<Record<EndReason, string>> = {
  done: "It ended well.",
  exit_code: "Its command said that it failed.",
  signal: "Its command was ended by a signal.",
  memory: "It used more memory than it may.",
  time: "It took longer than it may.",
  disk: "It wrote more than it may, or its runner had no room.",
  cancelled: "Somebody cancelled it.",
  command_not_found: "Its command is not in the image.",
  image_unavailable: "Its image could not be had.",
  not_possible: "The runner cannot give what it asks for.",
  inputs_unavailable: "Its files could not be had.",
  broken_report: "What it reported cannot be read.",
  results_not_stored: "Its results could not be stored.",
  lost: "Its runners were lost.",
};

export const severityTexts: Readonly<Record<Severity, string>> = { info: "Info", warning: "Warning", error: "Error" };

export const texts = {
  title: "Runs",
  lead: "What was asked to run, what runs, and how it ended.",
  label: "Runs",
  columns: { action: "Action", mission: "Mission", state: "State", by: "By", when: "Asked for", took: "Took", findings: "Findings" },
  findingCount: (count: number, severity: "error" | "warning" | "info") => counted(count, severity),
  ofFiles: (count: number) => counted(count, "file"),
  launch: "Run an action",
  actions: "Actions",
  filter: "Name of an action, * for any letters",
  allStates: "Any state",
  active: "Not over",
  mine: "Mine alone",
  narrowed: { mission_id: "One mission", action_id: "One action" },
  unnarrow: (what: string) => `No longer: ${what}`,
  empty: "There are no runs",
  emptyText: "An action reads the files of a mission and says what it found. Choose one, and the missions that it shall read.",
  emptyMission: "Nothing was run on this mission",
  emptyCommand: "klein action run script.py -p PROJECT -m MISSION",
  version: (number: number | null) => (number === null ? "not published" : `v${number}`),
  named: (name: string, mission: string) => `${name} on ${mission}`,
  unpublished: "not published",
  rerun: "Another try",

  on: "on",
  attempt: (number: number) => `try ${number}`,
  waits: "Waits",
  exitCode: (code: number) => `exit code ${code}`,
  progress: "Progress",
  cancelling: "It was asked to end.",
  reuses: "The very same was run before: what is shown is what that run found.",
  reusesLink: "That run",
  retryOf: "Another try of an earlier run",
  problems: "What could not be taken",
  problemsWhy: "The run said or left this, and it is not kept.",
  cancel: "Cancel",
  cancelTitle: "Cancel this run?",
  cancelWhy: "It ends within seconds. Its log stays.",
  retry: "Run again",
  retried: "It is in the queue again.",
  open: "Open",

  tabs: { label: "Parts of this run", log: "Log", findings: "Findings", metrics: "Metrics", artifacts: "Artifacts", inputs: "Inputs", definition: "Action" },
  previews: "Previews",
  about: "About",
  facts: { mission: "Mission", project: "Project", by: "Asked for by", at: "Asked for", runner: "Runner", took: "Took", inputs: "Read", image: "Image", network: "Network", attempt: "Try" },
  parameters: "Parameters",
  noParameters: "It takes none.",
  resources: "Resources",
  noSamples: "Nothing was measured yet.",
  plots: { cpu: "Processor", memory: "Memory", read: "Read", written: "Written" },
  cores: (cores: number) => `${cores.toFixed(cores < 10 ? 2 : 1)} cores`,
  most: (value: string) => `most ${value}`,
  plotSays: (name: string, now: string, most: string) => `${name}: ${now}, most ${most}`,
  commands: "Commands",
  inputsAre: (count: number, size: number) => `${counted(count, "file")}, ${formatSize(size)}`,

  log: {
    label: "Log",
    find: "Find in the log",
    found: (at: number, count: number) => (count === 0 ? "nothing found" : `${at} of ${count}`),
    foundMore: (at: number, count: number) => `${at} of more than ${count}`,
    next: "Next",
    previous: "Previous",
    follow: "Follow the end",
    empty: "It has written nothing.",
    notYet: "It has written nothing yet.",
    lines: (count: number) => counted(count, "line"),
    dropped: (count: number) => `${counted(count, "earlier line")} not shown: the command line has all of them.`,
    cut: " … (cut)",
  },
  findings: { severity: "How bad", code: "Code", message: "What", where: "Where", none: "It noticed nothing.", file: "File", topic: "Topic", time: "Log time", label: "Findings" },
  metrics: { name: "Name", value: "Value", unit: "Unit", file: "Of", none: "It measured nothing.", label: "Metrics" },
  artifacts: { path: "Path", size: "Size", act: "Download", none: "It left no files.", asFile: "A file of the mission", label: "Artifacts", download: (path: string) => `Download ${path}` },
  inputs: { path: "Path", size: "Size", sha256: "SHA-256", short: (sha256: string) => `${sha256.slice(0, 16)}…`, gone: "no longer there", none: "It was given no files.", label: "Inputs" },
  proposed: {
    title: "Proposed metadata",
    why: "What this run found out about the mission. Nothing is changed until you take it over.",
    name: "Field", now: "Now", proposed: "Proposed", take: "Take over", takeAll: "Take over all",
    takeOne: (name: string) => `Take over ${name}`,
    taken: "The mission has it now.", same: "The mission says all of this already.", empty: "–",
  },
  preview: {
    loading: "Fetching",
    tooLarge: (size: string) => `It has ${size}, which is too large to be shown here.`,
    unknown: "This kind of file is not shown here.",
    broken: "It cannot be read.",
    missing: "The run left no such file.",
    rows: (shown: number, all: number) => (shown < all ? `the first ${shown} of ${counted(all, "row")}` : counted(all, "row")),
    track: (points: number) => `A track of ${counted(points, "point")}`,
    start: "start", end: "end",
    metres: (value: number) => (value >= 1000 ? `${value / 1000} km` : `${value} m`),
  },
} as const;
