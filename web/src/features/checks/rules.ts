// The text of a `checks.yaml`: errors and positions in it.
import type { Problem } from "@/api/problem";

export interface TextError {
  /** From 1. */
  readonly line: number;
  /** From 1, in characters. */
  readonly column: number;
  readonly reason: string;
}

/** Returns where a text is wrong, and why; null for any other problem. */
export function textErrorOf(problem: Problem | null): TextError | null {
  if (problem?.code !== "yaml_invalid") return null;
  const { line, column, reason } = problem.document;
  if (typeof line !== "number" || typeof column !== "number" || typeof reason !== "string") return null;
  return { line, column, reason };
}

/** Returns the index of a line and column in a text, as an input counts; the end of the line or text where it is shorter. */
export function positionOf(text: string, line: number, column: number): number {
  const lines = text.split("\n");
  const at = Math.max(0, Math.min(lines.length, line) - 1);
  const start = lines.slice(0, at).reduce((sum, item) => sum + item.length + 1, 0);
  const before = Array.from(lines[at] ?? "").slice(0, Math.max(0, column - 1)).join("");
  return start + before.length;
}
