// Finds a text in a log, in short pieces that leave the page free, and goes on as the log grows.
import { computed, onScopeDispose, ref, shallowRef, watch } from "vue";
import type { Log } from "./useLog";

const MOST = 10_000;

export function useFinding(log: Log) {
  const text = ref("");
  const found = shallowRef<readonly number[]>([]);
  const at = ref(0);
  let from = 0;
  let timer: ReturnType<typeof setTimeout> | undefined;

  function look(): void {
    clearTimeout(timer);
    if (text.value === "" || found.value.length >= MOST || from >= log.lines.end) return;
    const next = log.lines.find(text.value, Math.max(from, log.lines.first));
    if (next.found.length > 0) found.value = [...found.value, ...next.found];
    if (next.upTo <= from) return;
    from = next.upTo;
    timer = setTimeout(look);
  }

  function begin(): void {
    found.value = [];
    [from, at.value] = [0, 0];
    look();
  }

  /** Goes to the next place or the one before; returns its line. */
  function step(by: 1 | -1): number | null {
    const count = found.value.length;
    if (count === 0) return null;
    at.value = (at.value + by + count) % count;
    return found.value[at.value] ?? null;
  }

  watch(text, begin);
  watch(log.version, look);
  onScopeDispose(() => clearTimeout(timer));
  return { text, count: computed(() => found.value.length), at, isMore: computed(() => found.value.length >= MOST), line: computed(() => found.value[at.value] ?? null), step };
}
