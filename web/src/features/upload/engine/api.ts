// The upload protocol as an upload asks it: every question is tried again until the server answers.

import type { PartToSign, ProblemDocument, SignedPart, UploadDecision, UploadFile, UploadFinish, UploadOutcome } from "./types";
import type { Gate } from "./flow";
import type { Backoff, Troubles } from "./backoff";
import type { Clock } from "./flow";

/** What the server answered: what was asked for, its problem, or nothing at all (`null`). */
export type Answer<T> = { readonly ok: T } | { readonly problem: ProblemDocument } | null;

/** The five questions, asked once each. */
export interface UploadApi {
  begin(missionId: string, files: readonly UploadFile[]): Promise<Answer<readonly UploadDecision[]>>;
  sign(parts: readonly PartToSign[]): Promise<Answer<readonly SignedPart[]>>;
  complete(finishes: readonly UploadFinish[]): Promise<Answer<readonly UploadOutcome[]>>;
  abort(uploadId: string): Promise<Answer<null>>;
}

/** The server refused; its problem says why. */
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

export interface Surroundings {
  readonly clock: Clock;
  readonly gate: Gate;
  readonly backoff: Backoff;
  readonly troubles: Troubles;
  /** The session has ended: the upload is paused until the person has signed in again. */
  readonly signedOut: () => void;
}

/** Asks until there is an answer. */
export class Asking {
  constructor(
    private readonly api: UploadApi,
    private readonly around: Surroundings,
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

  /** Free a name; where this cannot be said it expires by itself. */
  async abort(uploadId: string): Promise<void> {
    await this.api.abort(uploadId);
  }

  /** @throws ApiProblem, Stopped */
  private async insist<T>(ask: () => Promise<Answer<T>>): Promise<T> {
    const { clock, gate, backoff, troubles } = this.around;
    const tries = backoff.begin();
    for (;;) {
      await gate.passed();
      const answer = await ask();
      if (answer !== null && "ok" in answer) {
        troubles.over("server");
        return answer.ok;
      }
      if (answer === null || isAway(answer.problem)) {
        troubles.note("server", clock.now());
        await tries.pause();
      } else if (answer.problem.code === "rate_limited") {
        await backoff.wait(1000 * Number(answer.problem["retry_after_s"] ?? 1));
      } else if (answer.problem.code === "not_authenticated") {
        gate.close();
        this.around.signedOut();
      } else {
        throw new ApiProblem(answer.problem);
      }
    }
  }
}

function isAway(problem: ProblemDocument): boolean {
  return AWAY.has(problem.code) || AWAY_STATUS.has(problem.status);
}
