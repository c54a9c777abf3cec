// `Problem`: a failed request with its message, its remedy and its request ID.
import type { components } from "./schema";
import { texts } from "@/texts/problem";

export type ErrorCode = components["schemas"]["ErrorCode"];
export type FieldProblem = components["schemas"]["FieldProblem"];
type ProblemDocument = components["schemas"]["ProblemDocument"];

/** A failed request. `code` is the code of the server, or `unreachable` if the server did not respond. */
export class Problem extends Error {
  override readonly name = "Problem";

  constructor(
    readonly code: ErrorCode | "unreachable" | "unexpected",
    readonly status: number,
    readonly title: string,
    detail: string,
    readonly requestId: string | null = null,
    readonly document: Readonly<Record<string, unknown>> = {},
  ) {
    super(detail);
  }

  /** What a person can do about it, in a sentence. */
  get remedy(): string {
    return texts.remedies[this.code] ?? (this.status >= 500 ? texts.contactAdmin : "");
  }

  /** Errors of single fields of the request. */
  get fields(): readonly FieldProblem[] {
    const fields = this.document.problems;
    return Array.isArray(fields) ? fields.filter(isFieldProblem) : [];
  }

  /** The error of the submitted name, to be shown at its input; empty for other errors. */
  get ofName(): string {
    return this.code === "name_taken" || this.code === "path_conflict" ? this.message : "";
  }

  /** Whether asking the same again may well succeed. */
  get isPassing(): boolean {
    return this.code === "unreachable" || this.status === 503 || this.status === 429;
  }
}

function isFieldProblem(value: unknown): value is FieldProblem {
  return typeof value === "object" && value !== null && "field" in value && "message" in value;
}

function isDocument(value: unknown): value is ProblemDocument {
  return typeof value === "object" && value !== null && "code" in value && "detail" in value;
}

/** Returns the problem of a response. */
export function problemOf(body: unknown, answer: Response): Problem {
  const requestId = answer.headers.get("x-request-id");
  if (isDocument(body)) {
    return new Problem(body.code, body.status, body.title, body.detail, body.request_id ?? requestId, body);
  }
  const isGateway = answer.status >= 502 && answer.status <= 504;
  if (isGateway) return new Problem("unreachable", answer.status, texts.unreachable, texts.notAnswering, requestId);
  return new Problem("unexpected", answer.status, texts.unexpected, texts.notUnderstood(answer.status), requestId);
}

/** Returns the problem to show instead of a page; null while data is shown and the failure is temporary. */
export function problemInstead(thrown: unknown, shown: unknown): Problem | null {
  if (thrown === null || thrown === undefined) return null;
  const problem = toProblem(thrown);
  return shown !== undefined && problem.isPassing ? null : problem;
}

/** Converts anything thrown to a problem. Everything but a failed request is reported as a bug of the app. */
export function toProblem(thrown: unknown): Problem {
  if (thrown instanceof Problem) return thrown;
  if (thrown instanceof TypeError && /fetch|network|load failed/i.test(thrown.message)) {
    return new Problem("unreachable", 0, texts.unreachable, texts.notAnswering);
  }
  const detail = thrown instanceof Error ? thrown.message : String(thrown);
  return new Problem("unexpected", 0, texts.unexpected, detail);
}
