// The upload API with retries: each request is repeated until the server responds.
import type { PartToSign, ProblemDocument, SignedPart, UploadDecision, UploadFile, UploadFinish, UploadOutcome, WaitReason } from "./types";
import { checkStopped, type Clock, type Gate } from "./flow";
import createClient from "openapi-fetch";
import type { components, paths } from "@/api/schema";

/** A response: the result, a problem, or no response (`null`). */
export type Answer<T> = { readonly ok: T } | { readonly problem: ProblemDocument } | null;

/** The requests of the upload protocol, sent once. */
export interface UploadApi {
  begin(missionId: string, files: readonly UploadFile[]): Promise<Answer<readonly UploadDecision[]>>;
  sign(parts: readonly PartToSign[]): Promise<Answer<readonly SignedPart[]>>;
  complete(finishes: readonly UploadFinish[]): Promise<Answer<readonly UploadOutcome[]>>;
  abort(uploadId: string): Promise<Answer<null>>;
}

/** The server rejected a request. */
export class ApiProblem extends Error {
  override readonly name = "ApiProblem";

  constructor(readonly problem: ProblemDocument) {
    super(problem.detail);
  }

  get code(): string {
    return this.problem.code;
  }
}

const AWAY = new Set(["store_unavailable", "database_unavailable"]);
const AWAY_STATUS = new Set([502, 503, 504]);

export interface UploadContext {
  readonly clock: Clock;
  readonly gate: Gate;
  readonly backoff: Backoff;
  readonly waitReasons: WaitReasons;
  /** The session has ended: the upload is paused until the person has signed in again. */
  readonly signedOut: () => void;
}

/** Repeats requests until the server responds. */
export class RetryingApi {
  constructor(
    private readonly api: UploadApi,
    private readonly context: UploadContext,
  ) {}

  begin(missionId: string, files: readonly UploadFile[]): Promise<readonly UploadDecision[]> {
    return this.insist(() => this.api.begin(missionId, files));
  }

  sign(parts: readonly PartToSign[]): Promise<readonly SignedPart[]> {
    return this.insist(() => this.api.sign(parts));
  }

  complete(finishes: readonly UploadFinish[]): Promise<readonly UploadOutcome[]> {
    return this.insist(() => this.api.complete(finishes));
  }

  /** Free a name; if the request fails, the upload expires. */
  async abort(uploadId: string): Promise<void> {
    await this.api.abort(uploadId);
  }

  /** @throws ApiProblem, Stopped */
  private async insist<T>(ask: () => Promise<Answer<T>>): Promise<T> {
    const { clock, gate, backoff, waitReasons } = this.context;
    const tries = backoff.begin();
    for (;;) {
      await gate.passed();
      const answer = await ask();
      if (answer !== null && "ok" in answer) {
        waitReasons.over("server");
        return answer.ok;
      }
      if (answer === null || isAway(answer.problem)) {
        waitReasons.note("server", clock.now());
        await tries.pause();
      } else if (answer.problem.code === "rate_limited") {
        await backoff.wait(1000 * Number(answer.problem["retry_after_s"] ?? 1));
      } else if (answer.problem.code === "not_authenticated") {
        gate.close();
        this.context.signedOut();
      } else {
        throw new ApiProblem(answer.problem);
      }
    }
  }
}

function isAway(problem: ProblemDocument): boolean {
  return AWAY.has(problem.code) || AWAY_STATUS.has(problem.status);
}

type Schemas = components["schemas"];

export function httpApi(origin: string): UploadApi {
  const api = createClient<paths>({ baseUrl: origin });
  return {
    begin: async (missionId, files) => {
      const request = api.POST("/api/v1/missions/{mission_id}/uploads", {
        params: { path: { mission_id: missionId } },
        body: { files: [...files] },
      });
      return answered(request, (data) => (data as Schemas["UploadDecisions"]).items);
    },
    sign: async (parts) => {
      const request = api.POST("/api/v1/uploads/parts", { body: { parts: [...parts] } });
      return answered(request, (data) => (data as Schemas["SignedParts"]).items);
    },
    complete: async (finishes) => {
      const request = api.POST("/api/v1/uploads/complete", { body: { uploads: [...finishes] } });
      return answered(request, (data) => (data as Schemas["UploadOutcomes"]).items);
    },
    abort: async (uploadId) => {
      const request = api.DELETE("/api/v1/uploads/{upload_id}", { params: { path: { upload_id: uploadId } } });
      return answered(request, () => null);
    },
  };
}

interface ApiResponse {
  readonly data?: unknown;
  readonly error?: unknown;
  readonly response: Response;
}

async function answered<T>(request: Promise<ApiResponse>, read: (data: unknown) => T): Promise<Answer<T>> {
  let reply: ApiResponse;
  try {
    reply = await request;
  } catch {
    return null; // no connection, or an answer that broke off
  }
  const { data, error, response } = reply;
  if (response.ok) return { ok: read(data) };
  if (isProblem(error)) return { problem: error };
  if (response.status >= 502 && response.status <= 504) return null;
  const detail = `the answer has status ${response.status}, and says nothing that this page understands`;
  return { problem: { code: "internal_error", detail, status: response.status, title: "not understood", type: "about:blank" } };
}

function isProblem(value: unknown): value is ProblemDocument {
  return typeof value === "object" && value !== null && "code" in value && "detail" in value;
}

const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 8_000;

/** Reports what an upload waits for, and when that is over. */
export class WaitReasons {
  private readonly since = new Map<WaitReason, number>();

  constructor(private readonly onChange: (waitReason: WaitReason, isOver: boolean) => void) {}

  note(waitReason: WaitReason, now: number): void {
    if (this.since.has(waitReason)) return;
    this.since.set(waitReason, now);
    this.onChange(waitReason, false);
  }

  over(waitReason: WaitReason): void {
    if (this.since.delete(waitReason)) this.onChange(waitReason, true);
  }
}

/** The waits of all things that are tried again; the network's return cuts them short. */
export class Backoff {
  private nudged = new AbortController();

  constructor(
    private readonly clock: Clock,
    private readonly signal: AbortSignal,
    private readonly gate: Gate,
  ) {
    signal.addEventListener("abort", () => this.nudged.abort());
  }

  /** End all waits, so that pending retries happen now. */
  nudge(): void {
    this.nudged.abort();
    if (!this.signal.aborted) this.nudged = new AbortController();
  }

  /** Return the waits of one thing that is tried again. */
  begin(): Tries {
    return new Tries((milliseconds) => this.wait(milliseconds));
  }

  /** Wait so long, and for as long as the upload is paused. @throws Stopped */
  async wait(milliseconds: number): Promise<void> {
    checkStopped(this.signal);
    await this.clock.wait(milliseconds, this.nudged.signal);
    await this.gate.passed();
  }
}

/** Growing waits with jitter. */
export class Tries {
  private nextMs = FIRST_WAIT_MS;

  constructor(private readonly wait: (milliseconds: number) => Promise<void>) {}

  async pause(atLeastMs = 0): Promise<void> {
    const waitMs = Math.max(atLeastMs, this.nextMs * (0.5 + Math.random() / 2));
    this.nextMs = Math.min(this.nextMs * 2, LONGEST_WAIT_MS);
    await this.wait(waitMs);
  }
}
