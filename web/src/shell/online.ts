// Whether the server responds, according to the latest requests; probed after a failure.
import { useQueryClient } from "@tanstack/vue-query";
import { onScopeDispose, readonly, ref, watch, type Ref } from "vue";
import { Problem } from "@/api/problem";

const POLL_MS = 5000;

/** Returns whether the server responds. When it recovers, failed queries are refetched. */
export function useOnline(breaks: Readonly<Ref<number>>): Readonly<Ref<boolean>> {
  const queries = useQueryClient();
  const isReachable = ref(true);
  let timer: ReturnType<typeof setInterval> | undefined;

  function noteFailure(): void {
    isReachable.value = false;
    timer ??= setInterval(() => void check(), POLL_MS);
  }

  async function check(): Promise<void> {
    const answer = await fetch("/health/live").catch(() => null);
    if (answer?.ok !== true) {
      noteFailure();
      return;
    }
    if (isReachable.value) return;
    clearInterval(timer);
    timer = undefined;
    isReachable.value = true;
    void queries.invalidateQueries();
  }

  const stop = queries.getQueryCache().subscribe((event) => {
    if (event.type !== "updated" || event.query.state.fetchFailureCount === 0) return;
    const reason: unknown = event.query.state.fetchFailureReason;
    if (!(reason instanceof Problem) || reason.code !== "unreachable") return;
    noteFailure();
  });
  watch(breaks, check);
  onScopeDispose(() => {
    stop();
    clearInterval(timer);
  });
  return readonly(isReachable);
}
