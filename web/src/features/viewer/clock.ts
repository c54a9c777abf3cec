// The play head of the viewer: one time for all panels, in nanoseconds of the log clock.
import { onScopeDispose, readonly, ref, shallowRef, watch, type Ref } from "vue";
import type { Span } from "@/recordings/formats/recording";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10] as const;

export interface ClockState {
  readonly timeNs: bigint;
  /** From the first to the last message. */
  readonly span: Span;
  /** The part that is repeated. */
  readonly loop: Span | null;
  /** When something was recorded, in order. Playing skips what is between. */
  readonly recorded: readonly Span[];
}

const NS_PER_MS = 1e6;
/** A longer silence is skipped while playing. */
const SKIPPED_NS = 2_000_000_000n;
/** A frame that comes later than this did not play: the window was hidden. */
const MAX_FRAME_MS = 1_000;
/** About 30 frames a second: more take time from reading and drawing, and show no more. Cameras record 10 to 30. */
const FRAME_AFTER_MS = 22;
/** The play head waits for panels that have been reading for so long. */
const LATE_MS = 400;

/** Returns where the play head is after so many milliseconds, and whether it has reached the end. */
export function advanced({ timeNs, span, loop, recorded }: ClockState, elapsedMs: number, speed: number): { timeNs: bigint; isAtEnd: boolean } {
  const next = timeNs + BigInt(Math.round(elapsedMs * NS_PER_MS * speed));
  const isInLoop = loop !== null && timeNs >= loop.fromNs && timeNs <= loop.toNs;
  if (isInLoop && next > loop.toNs) return { timeNs: loop.fromNs, isAtEnd: false };
  const moved = afterSilence(next, recorded);
  return moved >= span.toNs ? { timeNs: span.toNs, isAtEnd: true } : { timeNs: moved, isAtEnd: false };
}

/** Returns the time, or the beginning of the next recording if that is far away and nothing was recorded until then. */
function afterSilence(timeNs: bigint, recorded: readonly Span[]): bigint {
  if (recorded.some(({ fromNs, toNs }) => timeNs >= fromNs && timeNs <= toNs)) return timeNs;
  const next = recorded.find(({ fromNs }) => fromNs > timeNs);
  return next !== undefined && next.fromNs - timeNs > SKIPPED_NS ? next.fromNs : timeNs;
}

/** Returns a time within a span. */
export function within({ fromNs, toNs }: Span, timeNs: bigint): bigint {
  if (timeNs < fromNs) return fromNs;
  return timeNs > toNs ? toNs : timeNs;
}

export interface Clock {
  readonly span: Span;
  readonly timeNs: Readonly<Ref<bigint>>;
  readonly isPlaying: Readonly<Ref<boolean>>;
  readonly speed: Readonly<Ref<number>>;
  readonly loop: Readonly<Ref<Span | null>>;
  readonly setSpeed: (speed: number) => void;
  /** Repeats a part while playing; null repeats nothing. */
  readonly setLoop: (loop: Span | null) => void;
  readonly seek: (timeNs: bigint) => void;
  readonly moveBy: (seconds: number) => void;
  readonly toggle: () => void;
  readonly pause: () => void;
  /** Notes that a panel reads what it shows now; call the result when it does no longer. */
  readonly wait: () => () => void;
}

/** Returns a clock that plays by the frames of the window. */
export function useClock(span: Span, recorded: readonly Span[], startNs: bigint): Clock {
  const timeNs = shallowRef(within(span, startNs));
  const isPlaying = ref(false);
  const speed = ref(1);
  const loop = shallowRef<Span | null>(null);
  const waiting = new Set<{ readonly sinceMs: number }>();
  let frame = 0;
  let timer: ReturnType<typeof setTimeout> | undefined;
  let lastMs = 0;

  function isLate(nowMs: number): boolean {
    return [...waiting].some(({ sinceMs }) => nowMs - sinceMs > LATE_MS);
  }

  function play(nowMs: number): void {
    next();
    const elapsedMs = Math.min(nowMs - lastMs, MAX_FRAME_MS);
    lastMs = nowMs;
    if (isLate(performance.now())) return;
    const head = advanced({ timeNs: timeNs.value, span, loop: loop.value, recorded }, elapsedMs, speed.value);
    timeNs.value = head.timeNs;
    if (head.isAtEnd) isPlaying.value = false;
  }

  /** A frame that is requested is drawn even if nothing changes. */
  function next(): void {
    timer = setTimeout(() => (frame = requestAnimationFrame(play)), FRAME_AFTER_MS);
  }

  function stop(): void {
    clearTimeout(timer);
    cancelAnimationFrame(frame);
  }

  function seek(to: bigint): void {
    timeNs.value = within(span, to);
  }

  watch(isPlaying, (isOn) => {
    stop();
    if (!isOn) return;
    if (timeNs.value >= span.toNs) timeNs.value = span.fromNs;
    lastMs = performance.now();
    frame = requestAnimationFrame(play);
  });
  onScopeDispose(stop);

  return {
    span,
    timeNs,
    isPlaying: readonly(isPlaying),
    speed,
    loop,
    setSpeed: (next) => (speed.value = next),
    setLoop: (next) => (loop.value = next),
    seek,
    moveBy: (seconds) => seek(timeNs.value + BigInt(Math.round(seconds * 1e9))),
    toggle: () => (isPlaying.value = !isPlaying.value),
    pause: () => (isPlaying.value = false),
    wait: () => {
      const entry = { sinceMs: performance.now() };
      waiting.add(entry);
      return () => waiting.delete(entry);
    },
  };
}
