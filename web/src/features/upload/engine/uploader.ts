// Announces files to the server and acts on its decisions. The pipeline sends the bytes.
//
// Files are announced in batches just before they are sent, so that no lease expires while others are sent.
import { ApiProblem, type UploadContext } from "./api";
import { batches } from "./plan";
import { Candidate, FileFailure } from "./reading";
import { Stopped } from "./flow";
import type { JournalFile, JournalHead } from "./journal";
import type { Failure, PlannedFile, ProblemDocument, UploadDecision, UploadFile } from "./types";
import { Pipeline } from "./pipeline";
import { Sending, type Parts } from "./sending";

export const CONNECTIONS = 4;
const MAX_STARTS = 4;
/** Problems that a retry does not solve. */
const FINAL = new Set(["file_exists", "path_conflict"]);

/** One run of an upload into one mission. */
export class Uploader {
  private readonly pipeline: Pipeline;
  private remembered = new Map<string, JournalFile>();
  private readonly starts = new Map<string, number>();
  private readonly leased: NameConflicts;
  private restarted: PlannedFile[] = [];

  constructor(
    private readonly head: JournalHead,
    private readonly parts: Parts,
  ) {
    this.leased = new NameConflicts(parts.context);
    this.pipeline = new Pipeline(parts, {
      uploaded: (sending, fileId) => this.uploaded(sending, fileId),
      failed: (sending, failure) => this.failed(sending, failure),
      again: (sending, problem) => this.again(sending, problem),
    });
  }

  /**
   * Upload the files; resolves when each has ended, or all was stopped.
   *
   * @throws ApiProblem, or whatever else concerns all files; those that had not ended have not been uploaded
   */
  async run(files: readonly PlannedFile[], connections = CONNECTIONS): Promise<void> {
    const { journal, stop } = this.parts;
    this.remembered = new Map((await journal.files(this.head.id)).map((file) => [file.path, file]));
    const loops = this.pipeline.loops(connections);
    try {
      await this.announceAll(files);
      await this.finishAll();
    } catch (error) {
      if (!(error instanceof Stopped)) this.pipeline.failure ??= error;
    }
    stop.abort();
    await loops;
    if (this.pipeline.failure !== null) throw this.pipeline.failure as Error;
  }

  private async finishAll(): Promise<void> {
    for (;;) {
      await this.leased.finishAll(
        (files) => this.announceAll(files),
        (file, problem) => this.refused(file, { kind: "problem", problem }),
      );
      await this.pipeline.drained();
      const restarted = this.restarted.splice(0);
      if (restarted.length === 0) return;
      await this.announceAll(restarted);
    }
  }

  private async announceAll(files: readonly PlannedFile[]): Promise<void> {
    for (const batch of batches(files)) await this.announce(batch);
  }

  private async announce(batch: readonly PlannedFile[]): Promise<void> {
    let announced: Candidate[] = [];
    for (const file of batch) {
      const candidate = await this.opened(file);
      if (candidate !== null) announced.push(candidate);
    }
    while (announced.length > 0) {
      const decisions = await this.begin(announced);
      if (decisions === null) return;
      // All written down before the first is sent: a crash from here on leaves none that cannot be resumed.
      await this.writeDown(announced, decisions);
      const again: Candidate[] = [];
      for (const [place, candidate] of announced.entries()) {
        if (await this.handleDecision(candidate, decisions[place] as UploadDecision)) again.push(candidate);
      }
      announced = again;
    }
  }

  private async begin(announced: readonly Candidate[]): Promise<readonly UploadDecision[] | null> {
    const files: UploadFile[] = announced.map((candidate) => candidate.announcement());
    try {
      return await this.parts.retryingApi.begin(this.head.mission.id, files);
    } catch (error) {
      if (!(error instanceof ApiProblem) || error.code !== "quota_exceeded") throw error;
      for (const { planned } of announced) this.refused(planned, { kind: "problem", problem: error.problem });
      return null;
    }
  }

  /** Take a file up: with what the journal remembers of it, and read already where it is small. */
  private async opened(planned: PlannedFile): Promise<Candidate | null> {
    const candidate = new Candidate(planned, this.remembered.get(planned.path) ?? null);
    try {
      const lost = candidate.dropOtherSize();
      if (lost !== null) await this.parts.retryingApi.abort(lost);
      if (candidate.isSmall) await this.hashWhole(candidate);
      return candidate;
    } catch (error) {
      if (!(error instanceof FileFailure)) throw error;
      this.refused(planned, { kind: error.kind, detail: error.detail });
      return null;
    }
  }

  private async hashWhole(candidate: Candidate): Promise<void> {
    const { hashing, watcher, context } = this.parts;
    const { path } = candidate.planned;
    watcher.read(path, 0);
    await candidate.hashWhole(hashing, (sizeBytes) => {
      watcher.read(path, sizeBytes);
      return context.gate.passed();
    });
  }

  private async writeDown(announced: readonly Candidate[], decisions: readonly UploadDecision[]): Promise<void> {
    const files: JournalFile[] = [];
    for (const [place, { planned }] of announced.entries()) {
      const decision = decisions[place];
      if (decision?.decision === "upload") files.push(this.written(planned, "sending", decision.upload.id));
    }
    if (files.length > 0) await this.note(files);
  }

  /** Act on a decision; return true if the file must be announced again with more data. */
  private async handleDecision(candidate: Candidate, decision: UploadDecision): Promise<boolean> {
    const { journal, watcher, context } = this.parts;
    const { planned } = candidate;
    switch (decision.decision) {
      case "hash_required":
        return this.hashFirst(candidate);
      case "refused":
        return this.refusedAtFirst(candidate, decision.problem);
      case "already_present":
      case "deduplicated": {
        const sha256 = decision.file?.sha256 ?? candidate.sha256;
        await this.note([this.written(planned, "done", null, sha256)]);
        watcher.stored(planned.path, planned.identity.sizeBytes);
        watcher.ended(planned.path, decision.decision, decision.file?.id ?? null, null);
        return false;
      }
      case "upload": {
        const written = await journal.parts(decision.upload.id);
        const now = context.clock.now();
        await this.pipeline.submit(new Sending(planned, decision.upload, written, candidate.sums, now));
        return false;
      }
    }
  }

  private async hashFirst(candidate: Candidate): Promise<boolean> {
    try {
      await this.hashWhole(candidate);
      return true;
    } catch (error) {
      if (!(error instanceof FileFailure)) throw error;
      this.refused(candidate.planned, { kind: error.kind, detail: error.detail });
      return false;
    }
  }

  private refusedAtFirst(candidate: Candidate, problem: ProblemDocument): boolean {
    if (problem.code === "upload_gone" && candidate.forgetUpload()) return true;
    if (problem.code === "name_leased") this.leased.add(candidate.planned, problem);
    else this.refused(candidate.planned, { kind: "problem", problem });
    return false;
  }

  private async uploaded(sending: Sending, fileId: string | null): Promise<void> {
    const done = this.written(sending.planned, "done", null, sending.toFinish().sha256);
    await this.note([done], [sending.upload.id]);
    this.parts.watcher.ended(sending.path, "uploaded", fileId, null);
  }

  private async failed(sending: Sending, failure: Failure): Promise<void> {
    if (failure.kind === "file_changed") await this.parts.retryingApi.abort(sending.upload.id); // its name is free at once
    const isResumable = failure.kind === "transfer_failed" || failure.kind === "file_unreadable";
    if (!isResumable) await this.note([this.written(sending.planned, "waiting")], [sending.upload.id]);
    this.refused(sending.planned, failure);
  }

  /** Start a file again, because its sent data is lost: the upload expired, or another client took over the name. */
  private async again(sending: Sending, problem: ProblemDocument): Promise<void> {
    const begun = (this.starts.get(sending.path) ?? 1) + 1;
    this.starts.set(sending.path, begun);
    const keepsParts = problem.code === "upload_incomplete";
    if (!keepsParts) await this.note([this.written(sending.planned, "waiting")], [sending.upload.id]);
    if (begun > MAX_STARTS) {
      this.refused(sending.planned, { kind: "problem", problem });
      return;
    }
    this.parts.watcher.reset(sending.path);
    this.restarted.push(sending.planned);
  }

  private refused(planned: PlannedFile, failure: Failure): void {
    this.parts.watcher.ended(planned.path, "refused", null, failure);
    if (failure.kind === "problem" && FINAL.has(failure.problem.code)) {
      void this.parts.journal.remove(this.head.id, [planned.path]);
    }
  }

  private async note(files: readonly JournalFile[], forgotten: readonly string[] = []): Promise<void> {
    for (const file of files) this.remembered.set(file.path, file);
    await this.parts.journal.note(files, forgotten);
  }

  private written(
    planned: PlannedFile,
    state: JournalFile["state"],
    uploadId: string | null = null,
    sha256: string | null = null,
  ): JournalFile {
    const { sizeBytes, modifiedMs } = planned.identity;
    return { id: this.head.id, path: planned.path, sizeBytes, modifiedMs, state, uploadId, sha256 };
  }
}

const GIVE_UP_MS = 90_000;
const POLL_MS = 2_000;

interface Waiting {
  readonly file: PlannedFile;
  readonly problem: ProblemDocument;
}

export class NameConflicts {
  private waiting: Waiting[] = [];

  constructor(private readonly context: UploadContext) {}

  add(file: PlannedFile, problem: ProblemDocument): void {
    this.waiting.push({ file, problem });
  }

  /** Announce the files again until each name is free or refused; the announcement adds those still leased. @throws Stopped */
  async finishAll(
    announce: (files: readonly PlannedFile[]) => Promise<void>,
    refuse: (file: PlannedFile, problem: ProblemDocument) => void,
  ): Promise<void> {
    if (this.waiting.length === 0) return;
    const { clock, backoff, waitReasons } = this.context;
    const givesUpMs = clock.now() + GIVE_UP_MS;
    waitReasons.note("lease", clock.now());
    while (this.waiting.length > 0 && clock.now() < givesUpMs) {
      await backoff.wait(POLL_MS);
      const then = this.waiting.splice(0);
      await announce(then.map(({ file }) => file));
      const ends = new Map(then.map(({ file, problem }) => [file.path, problem["lease_ends_at"]]));
      for (const item of this.waiting.splice(0)) {
        if (ends.get(item.file.path) === item.problem["lease_ends_at"]) this.waiting.push(item);
        else refuse(item.file, item.problem);
      }
    }
    for (const { file, problem } of this.waiting.splice(0)) refuse(file, problem);
    waitReasons.over("lease");
  }
}
