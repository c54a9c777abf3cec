// One reading at a time, which ends when another begins anew or its component goes.
import { onScopeDispose, ref, shallowRef, type Ref } from "vue";
import { failureOf, type ReadFailure } from "@/recordings/failures";

export interface Reading {
  readonly failure: Ref<ReadFailure | null>;
  readonly isReading: Ref<boolean>;
  /** Runs what reads, unless something is read already. Returns whether it was completed. */
  readonly attempt: (act: (signal: AbortSignal) => Promise<void>) => Promise<boolean>;
  /** Ends what is read. */
  readonly stop: () => void;
}

export function useReading(): Reading {
  const failure = shallowRef<ReadFailure | null>(null);
  const isReading = ref(false);
  let controller = new AbortController();

  async function attempt(act: (signal: AbortSignal) => Promise<void>): Promise<boolean> {
    if (isReading.value) return false;
    const own = controller;
    isReading.value = true;
    failure.value = null;
    try {
      await act(own.signal);
      return !own.signal.aborted;
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (own === controller && failed.code !== "cancelled") failure.value = failed;
      return false;
    } finally {
      if (own === controller) isReading.value = false;
    }
  }

  function stop(): void {
    controller.abort();
    controller = new AbortController();
    isReading.value = false;
  }

  onScopeDispose(() => controller.abort());
  return { failure, isReading, attempt, stop };
}
