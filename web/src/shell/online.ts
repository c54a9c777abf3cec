// Whether the server responds, judged by the latest requests and probed after a failure.
import { useQueryClient } from "@tanstack/vue-query";
import { onScopeDispose, readonly, ref, watch, type Ref } from "vue";
import { Problem } from "@/api/problem";

const AGAIN_MS = 5000;

/** Returns whether the server responds. When it recovers, failed queries are refetched. */
export function useOnline(breaks: Readonly<Ref<number>>): Readonly<Ref<boolean>> {
  const queries = useQueryClient();
  const isAnswered = ref(true);
  let timer: ReturnType<typeof setInterval> | undefined;

  function away(): void {
    isAnswered.value = false;
    timer ??= setInterval(() => void look(), AGAIN_MS);
  }

  async function look(): Promise<void> {
    const answer = await fetch("/health/live").catch(() => null);
    if (answer?.ok !== true) {
      away();
      return;
    }
    if (isAnswered.value) return;
    clearInterval(timer);
    timer = undefined;
    isAnswered.value = true;
    void queries.invalidateQueries();
  }

  const stop = queries.getQueryCache().subscribe((event) => {
    if (event.type !== "updated" || event.query.state.fetchFailureCount === 0) return;
    const reason: unknown = event.query.state.fetchFailureReason;
    if (!(reason instanceof Problem) || reason.code !== "unreachable") return;
    away();
  });
  watch(breaks, look);
  onScopeDispose(() => {
    stop();
    clearInterval(timer);
  });
  return readonly(isAnswered);
}
