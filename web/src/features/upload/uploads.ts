// The uploads of this page. They are kept outside of components, so that they continue during navigation. A worker does the
// work; it is loaded when the first upload begins.
import { computed, shallowReactive } from "vue";
import { signInAgain } from "@/api/client";
import type { Phase, Report } from "./engine/uploadQueue";
import type { JournalHead } from "./engine/journal";
import type { Command, Failure, FileProgress, FileState, PlannedFile, WaitReason } from "./engine/types";

export type Counts = Readonly<Record<FileState, number>>;

/** One upload as it is shown. */
export interface Run {
  readonly id: string;
  readonly head: JournalHead;
  readonly planned: readonly PlannedFile[];
  phase: Phase;
  failure: Failure | null;
  files: readonly FileProgress[];
  counts: Counts;
  doneBytes: number;
  totalBytes: number;
  bytesPerS: number | null;
  leftS: number | null;
  waitReasons: readonly WaitReason[];
  /** Files chosen since, which come after these. */
  further: readonly PlannedFile[];
}

const ACTIVE: ReadonlySet<Phase> = new Set(["running", "paused", "signed_out"]);
const byPath = new Map<string, Map<string, FileProgress>>();
const listeners = new Set<(run: Run) => void>();
let worker: Worker | null = null;

export const runs = shallowReactive(new Map<string, Run>());
export const activeRuns = computed(() => [...runs.values()].filter((run) => isActive(run)));

export function isActive(run: Run): boolean {
  return ACTIVE.has(run.phase);
}

/** Call back with each upload that has ended; returns a function that stops that. */
export function onOver(callback: (run: Run) => void): () => void {
  listeners.add(callback);
  return () => listeners.delete(callback);
}

/** Upload files into a mission, after its running upload. */
export function start(head: JournalHead, files: readonly PlannedFile[]): void {
  const now = runs.get(head.id);
  if (now !== undefined && isActive(now)) {
    now.further = [...now.further, ...files];
    return;
  }
  const run = shallowReactive<Run>({
    id: head.id, head, planned: files, phase: "running", failure: null, files: [], counts: counted([]), doneBytes: 0,
    totalBytes: files.reduce((sum, { identity }) => sum + identity.sizeBytes, 0), bytesPerS: null, leftS: null,
    waitReasons: [], further: [],
  });
  runs.set(head.id, run);
  byPath.set(head.id, new Map());
  ask({ kind: "start", head, files });
  warn();
}

/** Upload the missing files again. */
export function retry(run: Run): void {
  const missing = new Set(run.files.filter(({ state }) => state === "refused" || state === "left").map(({ path }) => path));
  start(run.head, run.planned.filter(({ path }) => missing.has(path)));
}

export function pause(id: string): void {
  ask({ kind: "pause", id });
}

export function resume(id: string): void {
  ask({ kind: "go_on", id });
}

export function cancel(id: string): void {
  const run = runs.get(id);
  if (run !== undefined) run.further = [];
  ask({ kind: "cancel", id });
}

/** Remove an ended upload from the page. */
export function dismiss(id: string): void {
  runs.delete(id);
  byPath.delete(id);
}

function ask(command: Command): void {
  if (worker === null) {
    worker = new Worker(new URL("./engine/upload.worker.ts", import.meta.url), { type: "module" });
    worker.addEventListener("message", ({ data }: MessageEvent<Report>) => note(data));
    worker.addEventListener("error", broke);
  }
  worker.postMessage(command);
}

function note({ id, phase, failure, snapshot }: Report): void {
  const run = runs.get(id);
  const files = byPath.get(id);
  if (run === undefined || files === undefined) return;
  const { changed, ...totals } = snapshot;
  const wasSignedOut = run.phase === "signed_out";
  Object.assign(run, { phase, failure }, totals);
  if (changed.length > 0) {
    for (const file of changed) files.set(file.path, file);
    run.files = [...files.values()];
    run.counts = counted(run.files);
  }
  if (phase === "signed_out" && !wasSignedOut) void signInAgain().then((isSignedIn) => (isSignedIn ? resume(id) : pause(id)));
  if (!isActive(run)) ended(run);
}

/** The worker stopped or could not be loaded, as after an update of the server. */
function broke(): void {
  worker?.terminate();
  worker = null;
  for (const run of activeRuns.value) {
    Object.assign(run, { phase: "failed", failure: { kind: "worker_ended", detail: "" }, further: [] });
    ended(run);
  }
}

function ended(run: Run): void {
  warn();
  for (const listener of listeners) listener(run);
  if (run.further.length > 0) start(run.head, run.further);
}

function counted(files: readonly FileProgress[]): Counts {
  const counts = { waiting: 0, reading: 0, sending: 0, uploaded: 0, already_present: 0, deduplicated: 0, refused: 0, left: 0 };
  for (const { state } of files) counts[state] += 1;
  return counts;
}

/** During uploads, the browser confirms before it closes the page. */
function warn(): void {
  window.removeEventListener("beforeunload", preventUnload);
  if (activeRuns.value.length > 0) window.addEventListener("beforeunload", preventUnload);
}

function preventUnload(event: BeforeUnloadEvent): void {
  event.preventDefault();
}
