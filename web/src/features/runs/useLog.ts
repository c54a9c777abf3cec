// Fetches the log of a run, piece after piece, until it is over; a new try of the run begins it anew.
import { onScopeDispose, readonly, ref, type Ref, shallowRef } from "vue";
import { LogLines } from "./log";
import { api, call } from "@/api/client";
import { type Problem, toProblem } from "@/api/problem";

const WAIT_S = 20;
const AGAIN_MS = 3_000;

export interface Log {
  readonly lines: LogLines;
  /** Grows with what has come. */
  readonly version: Readonly<Ref<number>>;
  readonly isOver: Readonly<Ref<boolean>>;
  readonly problem: Readonly<Ref<Problem | null>>;
}

export function useLog(runId: string): Log {
  const state = { lines: new LogLines() };
  const version = ref(0);
  const isOver = ref(false);
  const problem = shallowRef<Problem | null>(null);
  const ending = new AbortController();
  let attempt: number | null = null;
  let offset = 0;

  async function step(): Promise<void> {
    const params = { path: { run_id: runId }, query: { offset, wait_s: WAIT_S } };
    const piece = await call(api.GET("/api/v1/runs/{run_id}/log", { params, signal: ending.signal }));
    problem.value = null;
    if (attempt !== null && piece.attempt !== attempt) {
      state.lines = new LogLines();
      [offset, attempt] = [0, piece.attempt];
      version.value += 1;
      return;
    }
    attempt = piece.attempt;
    offset = piece.next_offset;
    state.lines.append(piece.text);
    isOver.value = piece.is_over;
    version.value += 1;
  }

  async function follow(): Promise<void> {
    while (!isOver.value && !ending.signal.aborted) {
      try {
        await step();
      } catch (thrown) {
        if (thrown instanceof DOMException && thrown.name === "AbortError") return;
        problem.value = toProblem(thrown);
        if (!problem.value.isPassing) return;
        await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
      }
    }
  }

  onScopeDispose(() => ending.abort());
  void follow();
  return {
    get lines() {
      return state.lines;
    },
    version: readonly(version),
    isOver: readonly(isOver),
    problem,
  };
}
