// The log of a run in memory: chunks of whole lines, addressed by line number. About fifty lines of 100 MB are visible, so a
// line is extracted only when it is rendered. Beyond a million lines the earliest are dropped.
import { computed, onScopeDispose, readonly, ref, shallowRef, watch, type Ref } from "vue";
import { api, call } from "@/api/client";
import { toProblem, type Problem } from "@/api/problem";

export const MAX_LINES = 1_000_000;
const MAX_SHOWN = 2_000;
/** A line that does not end is ended. */
const LONGEST = 65_536;
const MAX_FOUND = 10_000;
// eslint-disable-next-line no-control-regex -- these are removed
const ESCAPES = /\u001b\[[0-9;?]*[A-Za-z]|[\u0000-\u0008\u000b-\u001f]/g;

interface Piece {
  readonly text: string;
  /** Where each of its lines begins. */
  readonly starts: Uint32Array;
  readonly first: number;
}

function startsOf(text: string): Uint32Array {
  const starts: number[] = [];
  for (let at = 0; at < text.length; ) {
    starts.push(at);
    const end = text.indexOf("\n", at);
    at = end < 0 ? text.length : end + 1;
  }
  return Uint32Array.from(starts);
}

/** Returns a line as a terminal shows it in the end: without overwritten text and without colours. */
export function shownLine(line: string, cut: string): string {
  const whole = line.endsWith("\r") ? line.slice(0, -1) : line;
  const last = whole.slice(whole.lastIndexOf("\r") + 1).replaceAll(ESCAPES, "");
  return last.length > MAX_SHOWN ? last.slice(0, MAX_SHOWN) + cut : last;
}

/** A growing log. Line numbers start at 0 and stay when earlier lines are dropped. */
export class LogLines {
  private pieces: Piece[] = [];
  /** A last line that does not end yet. */
  private open = "";
  private next = 0;
  private least = 0;

  constructor(private readonly most = MAX_LINES) {}

  /** The number of the earliest line that is kept. */
  get first(): number {
    return this.least;
  }

  /** The number after that of the last line. */
  get end(): number {
    return this.next + (this.open === "" ? 0 : 1);
  }

  append(text: string): void {
    const all = this.open.length > LONGEST ? `${this.open}\n${text}` : this.open + text;
    const end = all.lastIndexOf("\n") + 1;
    this.open = all.slice(end);
    if (end === 0) return;
    const piece = { text: all.slice(0, end), starts: startsOf(all.slice(0, end)), first: this.next };
    this.pieces.push(piece);
    this.next += piece.starts.length;
    while (this.pieces.length > 1 && this.next - (this.pieces[1]?.first ?? 0) >= this.most) this.pieces.shift();
    this.least = this.pieces[0]?.first ?? 0;
  }

  line(number: number): string {
    if (number >= this.next) return number === this.next ? this.open : "";
    const piece = this.pieces[this.pieceOf(number)];
    if (piece === undefined || number < piece.first) return "";
    const at = number - piece.first;
    return piece.text.slice(piece.starts[at], (piece.starts[at + 1] ?? piece.text.length) - 1);
  }

  /** Finds a text, ignoring case, from line `from` on. Returns the matching lines and the line to continue at. */
  find(text: string, from: number): { readonly matches: readonly number[]; readonly upTo: number } {
    const lowered = text.toLocaleLowerCase();
    const matches: number[] = [];
    if (from >= this.next) return { matches, upTo: from };
    const piece = this.pieces[this.pieceOf(Math.max(from, this.least))];
    if (piece === undefined || lowered === "") return { matches, upTo: this.next };
    const within = piece.text.toLocaleLowerCase();
    for (let at = within.indexOf(lowered); at >= 0 && matches.length < MAX_FOUND; ) {
      const line = lastAtMost(piece.starts, at);
      if (piece.first + line >= from) matches.push(piece.first + line);
      at = within.indexOf(lowered, piece.starts[line + 1] ?? within.length);
    }
    return { matches, upTo: piece.first + piece.starts.length };
  }

  private pieceOf(number: number): number {
    let [low, high] = [0, this.pieces.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if ((this.pieces[middle]?.first ?? 0) <= number) low = middle;
      else high = middle - 1;
    }
    return low;
  }
}

function lastAtMost(starts: Uint32Array, at: number): number {
  let [low, high] = [0, starts.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if ((starts[middle] ?? 0) <= at) low = middle;
    else high = middle - 1;
  }
  return low;
}

const WAIT_S = 20;
const POLL_MS = 3_000;

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
        await new Promise((resolve) => setTimeout(resolve, POLL_MS));
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

const MAX = 10_000;

export function useFinding(log: Log) {
  const text = ref("");
  const matches = shallowRef<readonly number[]>([]);
  const at = ref(0);
  let from = 0;
  let timer: ReturnType<typeof setTimeout> | undefined;

  function searchNext(): void {
    clearTimeout(timer);
    if (text.value === "" || matches.value.length >= MAX || from >= log.lines.end) return;
    const next = log.lines.find(text.value, Math.max(from, log.lines.first));
    if (next.matches.length > 0) matches.value = [...matches.value, ...next.matches];
    if (next.upTo <= from) return;
    from = next.upTo;
    timer = setTimeout(searchNext);
  }

  function begin(): void {
    matches.value = [];
    [from, at.value] = [0, 0];
    searchNext();
  }

  /** Goes to the next place or the one before; returns its line. */
  function step(by: 1 | -1): number | null {
    const count = matches.value.length;
    if (count === 0) return null;
    at.value = (at.value + by + count) % count;
    return matches.value[at.value] ?? null;
  }

  watch(text, begin);
  watch(log.version, searchNext);
  onScopeDispose(() => clearTimeout(timer));
  return { text, count: computed(() => matches.value.length), at, isMore: computed(() => matches.value.length >= MAX), line: computed(() => matches.value[at.value] ?? null), step };
}
