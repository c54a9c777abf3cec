// One reading at a time, which ends when another begins anew or its component goes.
import { onScopeDispose, ref, shallowRef, type Ref } from "vue";
import { failureOf, type ReadFailure } from "@/recordings/failures";

type Act = (signal: AbortSignal) => Promise<void>;

export interface Reading {
  readonly failure: Ref<ReadFailure | null>;
  readonly isReading: Ref<boolean>;
  /** Runs what reads, unless something is read already. Returns whether it was completed. */
  readonly attempt: (act: Act) => Promise<boolean>;
  /** As `attempt`, for what nobody requested. */
  readonly attemptUnasked: (act: Act) => Promise<boolean>;
  /** After a jump: ends what is read unasked, and begins it anew, behind what others request now. */
  readonly restart: () => Promise<boolean>;
  /** Ends what is read. */
  readonly stop: () => void;
}

/** After a jump, requests for messages come within this time: those that are out of date end first. */
const REST_MS = 50;

export function useReading(): Reading {
  const failure = shallowRef<ReadFailure | null>(null);
  const isReading = ref(false);
  let controller = new AbortController();
  let unasked: Act | null = null;

  async function attempt(act: Act): Promise<boolean> {
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
      if (own === controller) [isReading.value, unasked] = [false, null];
    }
  }

  function attemptUnasked(act: Act): Promise<boolean> {
    return afterRest(act, 0);
  }

  function afterRest(act: Act, restMs: number): Promise<boolean> {
    if (isReading.value) return Promise.resolve(false);
    unasked = act;
    return attempt(async (signal) => {
      if (restMs > 0) await new Promise((resolve) => setTimeout(resolve, restMs));
      if (!signal.aborted) await act(signal);
    });
  }

  function restart(): Promise<boolean> {
    const act = unasked;
    if (act !== null) stop();
    else if (failure.value !== null) return Promise.resolve(false);
    return afterRest(act ?? (() => Promise.resolve()), REST_MS);
  }

  function stop(): void {
    controller.abort();
    controller = new AbortController();
    [isReading.value, unasked] = [false, null];
  }

  onScopeDispose(() => controller.abort());
  return { failure, isReading, attempt, attemptUnasked, restart, stop };
}
