// The concurrent loops of an upload: hash (the caller), sign, send, complete, renew leases.
//
// Each byte is read once for its checksums; the body of a PUT is a slice of the file, which the browser reads again. So
// memory is a few slices, and the store rejects a part whose bytes changed in between, because the server signed its
// checksum. At most `MAX_UNSENT_BYTES` are hashed and not yet sent.
import { ApiProblem, type RetryingApi, type UploadContext } from "./api";
import { Budget, Changed, checkStopped, Queue, Stopped } from "./flow";
import type { Failure, ProblemDocument, SignedPart, UploadOutcome } from "./types";
import { checkUnchanged, FileFailure } from "./reading";
import { sendPart, StoreRefused, toSign, type Part, type Parts, type Sending } from "./sending";

const MAX_UNSENT_BYTES = 128 * 1024 * 1024;
const PART_COST = 512 * 1024; // what the smallest part counts, so that files under way are bounded too
const MAX_ACTIVE_FILES = 256;
const AT_ONCE = 100;
const LINGER_MS = 20;
const GATHER_MS = 500;

/** Callbacks at the end of each upload. `again`: the sent data is lost, and the file must be announced again. */
export interface Ends {
  uploaded(sending: Sending, fileId: string | null): Promise<void>;
  failed(sending: Sending, failure: Failure): Promise<void>;
  again(sending: Sending, problem: ProblemDocument): Promise<void>;
}

const RESTARTABLE = new Set(["upload_gone", "not_found", "upload_incomplete"]);

export class Pipeline {
  /** What stopped everything, where something did. */
  failure: unknown = null;
  private readonly unsent: Budget;
  private readonly activeFiles: Budget;
  private readonly toSign: Queue<Part>;
  private readonly toSend: Queue<readonly [Part, SignedPart]>;
  private readonly toFinish: Queue<Sending>;
  private readonly leases: Leases;

  constructor(
    private readonly parts: Parts,
    private readonly ends: Ends,
  ) {
    const changed = new Changed(parts.stop.signal);
    const { clock } = parts.context;
    this.leases = new Leases(parts.retryingApi, parts.context, parts.stop.signal);
    this.unsent = new Budget(changed, MAX_UNSENT_BYTES);
    this.activeFiles = new Budget(changed, MAX_ACTIVE_FILES);
    this.toSign = new Queue(changed, clock);
    this.toSend = new Queue(changed, clock);
    this.toFinish = new Queue(changed, clock);
  }

  /** Start the loops, with `connections` senders. Resolves when all have ended. */
  async loops(connections: number): Promise<void> {
    const renewing = () => this.leases.renewing((sending, error) => this.handleFailure(sending, error));
    const loops = [() => this.signing(), () => this.finishing(), renewing];
    for (let number = 0; number < connections; number++) loops.push(() => this.sending());
    await Promise.all(loops.map((loop) => this.guarded(loop)));
  }

  private async guarded(loop: () => Promise<never>): Promise<void> {
    try {
      await loop();
    } catch (error) {
      if (error instanceof Stopped) return;
      this.failure ??= error;
      this.parts.stop.abort();
    }
  }

  /** Hash an upload's parts and queue those that the store does not hold; waits while enough is under way. */
  async submit(sending: Sending): Promise<void> {
    const { hashing, watcher } = this.parts;
    await this.activeFiles.acquire(1);
    this.leases.track(sending);
    const isHashed = sending.sums !== null;
    try {
      if (!isHashed) hashing.beginWhole();
      for (const [number, offset, sizeBytes] of sending.ranges()) {
        if (sending.ended) break;
        await this.queuePart(sending, number, offset, sizeBytes);
      }
      if (!isHashed && !sending.ended) sending.sums = hashing.endWhole();
      watcher.state(sending.path, "sending");
    } catch (error) {
      await this.handleFailure(sending, error);
    }
    this.countDone(sending);
  }

  /** Wait until every upload submitted has ended. @throws Stopped */
  drained(): Promise<void> {
    return this.activeFiles.drained();
  }

  private async queuePart(sending: Sending, number: number, offset: number, sizeBytes: number): Promise<void> {
    const { hashing, watcher, context, stop } = this.parts;
    await context.gate.passed();
    const read = () => {
      checkStopped(stop.signal);
      watcher.state(sending.path, "sending");
    };
    const checksum = await sending.hashPart(hashing, offset, sizeBytes, read);
    sending.latest = { upload_id: sending.upload.id, number, checksum };
    if (sending.isStored(number, sizeBytes, checksum)) {
      watcher.stored(sending.path, sizeBytes);
      return;
    }
    const cost = Math.max(sizeBytes, PART_COST);
    await this.unsent.acquire(cost);
    sending.addPart();
    this.toSign.put({ sending, number, offset, sizeBytes, checksum, cost });
  }

  private async signing(): Promise<never> {
    for (;;) {
      const parts = await this.toSign.take(AT_ONCE);
      // More come within moments: one question for all of them.
      if (parts.length < AT_ONCE) parts.push(...(await this.toSign.gather(AT_ONCE - parts.length, LINGER_MS)));
      for (const part of parts) if (part.sending.ended) this.partOver(part);
      await this.sign(parts.filter((part) => !part.sending.ended));
    }
  }

  private async sign(parts: readonly Part[]): Promise<void> {
    if (parts.length === 0) return;
    try {
      const signed = await this.parts.retryingApi.sign(parts.map(toSign));
      parts.forEach((part, place) => {
        part.sending.renewedMs = this.parts.context.clock.now();
        this.toSend.put([part, signed[place] as SignedPart]);
      });
    } catch (error) {
      if (!(error instanceof ApiProblem) || !RESTARTABLE.has(error.code)) throw error;
      await this.signSeparately(parts, error);
    }
  }

  /** Sign each upload separately, to find the one that has ended; the others continue. */
  private async signSeparately(parts: readonly Part[], error: ApiProblem): Promise<void> {
    const sendings = new Set(parts.map((part) => part.sending));
    if (sendings.size > 1) {
      for (const item of sendings) await this.sign(parts.filter((part) => part.sending === item));
      return;
    }
    for (const part of parts) {
      await this.restart(part.sending, error.problem);
      this.partOver(part);
    }
  }

  private async sending(): Promise<never> {
    for (;;) {
      for (const [part, signed] of await this.toSend.take(1)) {
        try {
          if (!part.sending.ended) await sendPart(part, signed, this.parts);
        } catch (error) {
          await this.handleFailure(part.sending, error);
        }
        this.partOver(part);
      }
    }
  }

  private async finishing(): Promise<never> {
    for (;;) {
      const sent = await this.toFinish.take(AT_ONCE);
      if (sent.length < Math.min(AT_ONCE, this.activeFiles.used)) {
        sent.push(...(await this.toFinish.gather(AT_ONCE - sent.length, GATHER_MS)));
      }
      const ready: Sending[] = [];
      for (const sending of sent) if (await this.isUnchanged(sending)) ready.push(sending);
      if (ready.length === 0) continue;
      const outcomes = await this.parts.retryingApi.complete(ready.map((sending) => sending.toFinish()));
      for (const [place, sending] of ready.entries()) {
        await this.finished(sending, outcomes[place] as UploadOutcome);
        this.release(sending);
      }
    }
  }

  private async isUnchanged(sending: Sending): Promise<boolean> {
    try {
      await checkUnchanged(sending.planned);
      return true;
    } catch (error) {
      await this.handleFailure(sending, error);
      this.release(sending);
      return false;
    }
  }

  private async finished(sending: Sending, outcome: UploadOutcome): Promise<void> {
    if (outcome.outcome === "completed") {
      if (sending.end()) await this.ends.uploaded(sending, outcome.file?.id ?? null);
    } else if (RESTARTABLE.has(outcome.problem.code)) {
      await this.restart(sending, outcome.problem);
    } else {
      await this.fail(sending, { kind: "problem", problem: outcome.problem });
    }
  }

  /** Handle an error of one file; rethrow errors that concern all files. */
  private async handleFailure(sending: Sending, error: unknown): Promise<void> {
    if (error instanceof FileFailure) await this.fail(sending, { kind: error.kind, detail: error.detail });
    else if (error instanceof StoreRefused) await this.fail(sending, { kind: "transfer_failed", detail: error.message });
    else if (error instanceof ApiProblem && RESTARTABLE.has(error.code)) await this.restart(sending, error.problem);
    else throw error;
  }

  private async fail(sending: Sending, failure: Failure): Promise<void> {
    if (sending.end()) await this.ends.failed(sending, failure);
  }

  private async restart(sending: Sending, problem: ProblemDocument): Promise<void> {
    if (sending.end()) await this.ends.again(sending, problem);
  }

  private partOver(part: Part): void {
    this.unsent.release(part.cost);
    this.countDone(part.sending);
  }

  private countDone(sending: Sending): void {
    if (!sending.partDone()) return;
    this.leases.untrack(sending);
    if (sending.ended) this.release(sending);
    else this.toFinish.put(sending);
  }

  private release(sending: Sending): void {
    this.leases.untrack(sending);
    this.activeFiles.release(1);
  }
}

const RENEW_MS = 20_000;

export class Leases {
  private readonly active = new Set<Sending>();

  constructor(
    private readonly retryingApi: RetryingApi,
    private readonly context: UploadContext,
    private readonly signal: AbortSignal,
  ) {}

  track(sending: Sending): void {
    this.active.add(sending);
  }

  untrack(sending: Sending): void {
    this.active.delete(sending);
  }

  /** Renew leases when they are due; `failed` receives errors of one upload. @throws Stopped */
  async renewing(failed: (sending: Sending, error: unknown) => Promise<void>): Promise<never> {
    for (;;) {
      await this.context.clock.wait(RENEW_MS, this.signal);
      checkStopped(this.signal);
      const due = this.context.clock.now() - RENEW_MS;
      for (const sending of this.active) {
        // A paused upload does not renew its leases: another client may take the names.
        if (this.context.gate.isShut || sending.ended || sending.latest === null || sending.renewedMs >= due) continue;
        sending.renewedMs = this.context.clock.now();
        try {
          await this.retryingApi.sign([sending.latest]);
        } catch (error) {
          await failed(sending, error);
        }
      }
    }
  }
}
