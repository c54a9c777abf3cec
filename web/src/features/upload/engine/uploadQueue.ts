// The uploads of a page, one per mission at a time: start, pause, cancel, report progress.

import { ApiProblem, Backoff, RetryingApi, WaitReasons, type UploadApi, type UploadContext } from "./api";
import { Hashing } from "./checksums";
import { Gate, type Clock } from "./flow";
import { lockName, type Journal, type JournalHead } from "./journal";
import { ProgressStore, type Snapshot } from "./progressStore";
import type { Failure, PlannedFile } from "./types";
import type { Store } from "./store";
import { Uploader } from "./uploader";

const REPORT_MS = 250;

/**
 * `signed_out`: it waits until the person has signed in again. `elsewhere`: another tab of this browser uploads into the
 * mission. `failed`: something that concerns all files; what was sent is kept.
 */
export type Phase = "running" | "paused" | "signed_out" | "elsewhere" | "failed" | "cancelled" | "over";

export interface Report {
  readonly id: string;
  readonly phase: Phase;
  readonly failure: Failure | null;
  readonly snapshot: Snapshot;
}

export interface UploadQueueParts {
  readonly api: UploadApi;
  readonly store: Store;
  readonly journal: Journal;
  readonly clock: Clock;
  readonly report: (report: Report) => void;
  /** Run alone among the tabs of this browser; false, without running, where another has the name. */
  readonly alone: (name: string, run: () => Promise<void>) => Promise<boolean>;
}

interface Run {
  readonly id: string;
  readonly progress: ProgressStore;
  readonly stop: AbortController;
  readonly gate: Gate;
  readonly backoff: Backoff;
  phase: Phase;
  failure: Failure | null;
}

export class UploadQueue {
  private readonly runs = new Map<string, Run>();
  private readonly ends = new Map<string, Promise<void>>();

  constructor(private readonly parts: UploadQueueParts) {}

  /** Upload files into a mission, after its running upload; resolves when both have ended. */
  async start(head: JournalHead, files: readonly PlannedFile[]): Promise<void> {
    try {
      await this.parts.journal.begin(
        head,
        files.map(({ path, identity }) => ({ id: head.id, path, ...identity, state: "waiting", uploadId: null, sha256: null })),
      );
    } catch (error) {
      const progress = new ProgressStore(files);
      progress.leave();
      this.parts.report({ id: head.id, phase: "failed", failure: asFailure(error), snapshot: progress.snapshot(this.parts.clock.now()) });
      return;
    }
    const before = this.ends.get(head.id) ?? Promise.resolve();
    const end = before.then(() => this.run(head, files));
    this.ends.set(head.id, end);
    await end;
  }

  pause(id: string): void {
    const run = this.runs.get(id);
    if (run === undefined) return;
    run.phase = "paused";
    run.gate.close();
    this.reportRun(run);
  }

  resume(id: string): void {
    const run = this.runs.get(id);
    if (run === undefined) return;
    run.phase = "running";
    run.progress.meter.restart();
    run.gate.open();
    run.backoff.nudge();
    this.reportRun(run);
  }

  /** Cancel an upload: uploaded files stay, the rest is discarded. */
  cancel(id: string): void {
    const run = this.runs.get(id);
    if (run === undefined) return;
    run.phase = "cancelled";
    run.stop.abort();
  }

  /** The network is back: retry now. */
  nudge(): void {
    for (const run of this.runs.values()) run.backoff.nudge();
  }

  private async run(head: JournalHead, files: readonly PlannedFile[]): Promise<void> {
    const { clock, alone } = this.parts;
    const run = this.opened(head, files);
    this.runs.set(head.id, run);
    const telling = this.telling(run);
    if (!(await alone(lockName(head.id), () => this.upload(run, head, files)))) run.phase = "elsewhere";
    run.stop.abort();
    await telling;
    this.runs.delete(head.id);
    if (run.phase !== "over") run.progress.leave();
    this.parts.report({ id: run.id, phase: run.phase, failure: run.failure, snapshot: run.progress.snapshot(clock.now()) });
  }

  private opened(head: JournalHead, files: readonly PlannedFile[]): Run {
    const stop = new AbortController();
    const gate = new Gate(stop.signal);
    const backoff = new Backoff(this.parts.clock, stop.signal, gate);
    return { id: head.id, progress: new ProgressStore(files), stop, gate, backoff, phase: "running", failure: null };
  }

  private async upload(run: Run, head: JournalHead, files: readonly PlannedFile[]): Promise<void> {
    const { api, store, journal, clock } = this.parts;
    const { progress: watcher, gate, backoff, stop } = run;
    const waitReasons = new WaitReasons((waitReason, isOver) => watcher.waitReason(waitReason, isOver));
    const signedOut = () => {
      run.phase = "signed_out";
      this.reportRun(run);
    };
    const context: UploadContext = { clock, gate, backoff, waitReasons, signedOut };
    const retryingApi = new RetryingApi(api, context);
    try {
      const hashing = await Hashing.ready();
      await new Uploader(head, { retryingApi, store, journal, hashing, watcher, context, stop }).run(files);
      if (run.phase === "cancelled") await this.forget(head.id);
      else run.phase = "over";
      await this.close(head.id);
    } catch (error) {
      run.phase = "failed";
      run.failure = asFailure(error);
    }
  }

  /** Forget an upload that was given up, and free the names that it holds. */
  async forget(id: string): Promise<void> {
    const { journal, api } = this.parts;
    const open = (await journal.files(id)).flatMap(({ uploadId }) => (uploadId === null ? [] : [uploadId]));
    await journal.drop(id);
    for (const uploadId of open) await api.abort(uploadId); // if this fails, the upload expires
  }

  /** Drop the journal of an upload that is all there. */
  private async close(id: string): Promise<void> {
    const files = await this.parts.journal.files(id);
    if (files.every((file) => file.state === "done")) await this.parts.journal.drop(id);
  }

  private async telling(run: Run): Promise<void> {
    while (!run.stop.signal.aborted) {
      this.reportRun(run);
      await this.parts.clock.wait(REPORT_MS, run.stop.signal);
    }
  }

  private reportRun(run: Run): void {
    const { id, phase, failure, progress } = run;
    this.parts.report({ id, phase, failure, snapshot: progress.snapshot(this.parts.clock.now()) });
  }
}

function asFailure(error: unknown): Failure {
  if (error instanceof ApiProblem) return { kind: "problem", problem: error.problem };
  return { kind: "transfer_failed", detail: error instanceof Error ? error.message : String(error) };
}
