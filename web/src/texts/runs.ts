// Texts of runs: states, the list, and the run page.
import type { components } from "@/api/schema";
import type { RunState } from "@/api/types";
import { counted, formatSize } from "@/components/format";

type EndReason = components["schemas"]["EndReason"];
type RunPriority = components["schemas"]["RunPriority"];
type Severity = components["schemas"]["Severity"];

interface Named {
  readonly label: string;
  readonly why: string;
}

export const stateTexts: Readonly<Record<RunState, Named>> = {
  queued: { label: "Queued", why: "Waiting for a runner." },
  preparing: { label: "Preparing", why: "A runner downloads the image, the input files and the packages of the script." },
  running: { label: "Running", why: "The command is running." },
  collecting: { label: "Collecting", why: "The runner is uploading the results." },
  done: { label: "Done", why: "The run succeeded." },
  failed: { label: "Failed", why: "The run failed; see the run page for the reason." },
  cancelled: { label: "Cancelled", why: "Someone cancelled the run." },
};

export const reasonTexts: Readonly<Record<EndReason, string>> = {
  done: "The run succeeded.",
  exit_code: "The command returned a non-zero exit code.",
  signal: "A signal ended the command.",
  memory: "The run exceeded its memory limit.",
  time: "The run exceeded its time limit.",
  disk: "The run exceeded its disk limit, or the runner ran out of disk space.",
  cancelled: "Someone cancelled the run.",
  command_not_found: "The image does not contain the command.",
  image_unavailable: "The runner could not get the image.",
  not_possible: "The runner does not have the required resources.",
  inputs_unavailable: "The runner could not get the input files.",
  broken_report: "The report of the run is not readable, or the server did not accept it.",
  results_not_stored: "The runner could not upload the results.",
  lost: "Contact with the runner was lost.",
};

export const priorityTexts: Readonly<Record<RunPriority, string>> = { low: "Low", normal: "Normal", high: "High" };

export const severityTexts: Readonly<Record<Severity, string>> = { info: "Info", warning: "Warning", error: "Error" };

export const texts = {
  title: "Runs",
  lead: "Queued, active, and finished runs of actions.",
  label: "Runs",
  columns: { action: "Action", mission: "Mission", state: "State", by: "Started by", when: "Created", took: "Duration", where: "Node and job", findings: "Checks and findings" },
  findingCount: (count: number, severity: "error" | "warning" | "info") => counted(count, severity),
  checkCount: (count: number, status: "error" | "warning" | "not_made") =>
    status === "not_made" ? `${counted(count, "check")} not made` : status === "error" ? `${counted(count, "check")} failed` : counted(count, "check warning"),
  doneWith: { bad: "Done: bad", warnings: "Done: warnings" },
  doneWithWhy: { bad: "The run succeeded, and found errors in the mission.", warnings: "The run succeeded, with warnings about the mission." },
  values: (count: number) => counted(count, "value"),
  launch: "Run an action",
  actions: "Actions",
  filter: "Filter by action; * matches any text",
  allStates: "All states",
  active: "Active",
  mine: "Only mine",
  idFilters: { mission_id: () => "One mission", action_id: () => "One action", node: (value: string) => `On ${value}`, job_id: (value: string) => `Job ${value}` },
  removeFilter: (what: string) => `Remove filter: ${what}`,
  empty: "No runs yet",
  emptyText: "An action processes the files of a mission. Choose an action and missions to run it on.",
  emptyMission: "No runs on this mission",
  emptyCommand: "klein action run script.py -p PROJECT -m MISSION",
  version: (number: number | null) => (number === null ? "not published" : `v${number}`),
  named: (name: string, mission: string) => `${name} on ${mission}`,

  on: "on",
  attempt: (number: number) => `attempt ${number}`,
  waits: "Waiting",
  exitCode: (code: number) => `exit code ${code}`,
  progress: "Progress",
  cancelling: "Cancelling.",
  reuses: "An identical run exists. This page shows its results.",
  reusesLink: "Show that run",
  retryOf: "Retry of an earlier run",
  problems: "Rejected output",
  problemsWhy: "The run produced this output, but it could not be stored.",
  cancel: "Cancel",
  cancelTitle: "Cancel this run?",
  cancelWhy: "The run stops within seconds. Its log is kept.",
  retry: "Run again",
  retried: "Run queued again.",
  open: "Open",

  tabs: { label: "Parts of this run", log: "Log", findings: "Findings", checks: "Checks", metrics: "Metrics", artifacts: "Artifacts", inputs: "Inputs", definition: "Action" },
  previews: "Previews",
  about: "About",
  facts: { mission: "Mission", project: "Project", by: "Started by", at: "Created", priority: "Priority", runner: "Runner", took: "Duration", inputs: "Inputs", image: "Image", isolation: "Isolation", node: "Node", job: "Job", queued: "Queue wait", requeues: "Requeued", gpus: "GPUs", accounted: "Accounted", network: "Network", attempt: "Attempt" },
  job: (id: string) => `job ${id}`,
  sameNode: "Show the runs on this node",
  gpuNumber: (id: string) => `GPU ${id}`,
  times: (count: number) => counted(count, "time"),
  coreSeconds: (seconds: number) => `${seconds.toFixed(1)} s of cores`,
  memoryAtMost: (size: string) => `${size} of memory at most`,
  parameters: "Parameters",
  noParameters: "No parameters.",
  resources: "Resources",
  noSamples: "No measurements yet.",
  plots: { cpu: "CPU", memory: "Memory", read: "Read", written: "Written" },
  cores: (cores: number) => `${cores.toFixed(cores < 10 ? 2 : 1)} cores`,
  most: (value: string) => `maximum ${value}`,
  plotSays: (name: string, now: string, most: string) => `${name}: ${now}, maximum ${most}`,
  commands: "Commands",
  inputsAre: (count: number, size: number) => `${counted(count, "file")}, ${formatSize(size)}`,

  log: {
    label: "Log",
    find: "Search the log",
    matches: (at: number, count: number) => (count === 0 ? "no matches" : `${at} of ${count}`),
    foundMore: (at: number, count: number) => `${at} of more than ${count}`,
    next: "Next",
    previous: "Previous",
    follow: "Follow",
    empty: "No log output.",
    notYet: "No log output yet.",
    lines: (count: number) => counted(count, "line"),
    dropped: (count: number) => `${counted(count, "earlier line")} not shown. Use the command line to see all of them.`,
    cut: "… (truncated)",
  },
  findings: { severity: "Severity", code: "Code", message: "Message", where: "Location", none: "No findings.", file: "File", topic: "Topic", time: "Log time", label: "Findings" },
  checks: { name: "Check", value: "Value", where: "Location", status: "Status", none: "No checks.", label: "Checks" },
  allVerdicts: "All verdicts",
  verdict: "Verdict",
  metrics: { name: "Name", value: "Value", unit: "Unit", where: "File or topic", labels: "Labels", none: "No metrics.", label: "Metrics" },
  artifacts: { path: "Path", size: "Size", act: "Download", none: "No artifacts.", asFile: "Added to the mission", label: "Artifacts", download: (path: string) => `Download ${path}` },
  inputs: { path: "Path", size: "Size", sha256: "SHA-256", short: (sha256: string) => `${sha256.slice(0, 16)}…`, gone: "deleted", none: "No input files.", label: "Inputs" },
  proposed: {
    title: "Proposed metadata",
    why: "Metadata that this run proposes for the mission. Nothing changes until you apply it.",
    name: "Field", now: "Current", proposed: "Proposed", take: "Apply", takeAll: "Apply all",
    takeOne: (name: string) => `Apply ${name}`,
    taken: "Applied to the mission.", same: "The mission already has these values.", empty: "–",
  },
  preview: {
    loading: "Loading",
    tooLarge: (size: string) => `At ${size}, this file is too large for a preview.`,
    unknown: "No preview for this file type.",
    broken: "This file is not readable.",
    missing: "The run has no such file.",
    rows: (shown: number, all: number) => (shown < all ? `first ${shown} of ${counted(all, "row")}` : counted(all, "row")),
    track: (points: number) => `A track of ${counted(points, "point")}`,
    start: "start", end: "end",
    metres: (value: number) => (value >= 1000 ? `${value / 1000} km` : `${value} m`),
  },
} as const;
