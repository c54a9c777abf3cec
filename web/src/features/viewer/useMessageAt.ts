// The message of a topic that is valid at the time of the play head, as a product.
import { onScopeDispose, ref, shallowRef, watch, type Ref, type ShallowRef } from "vue";
import type { Series } from "./layout";
import { areFar, MAX_SEARCH_BYTES, useViewer } from "./viewer";
import { latest } from "@/features/file/viewer/useReader";
import { failureOf, type ReadFailure } from "@/recordings/failures";
import type { ProductName, Products, ReadMessage } from "@/recordings/products/products";
import type { DamagedPart } from "@/recordings/protocol";

export interface ShownMessage<P extends ProductName> extends ReadMessage<P> {
  readonly product: Products[P];
}

export interface MessageAtTime<P extends ProductName> {
  /** Null where there is none at or before the time. */
  readonly shown: ShallowRef<ShownMessage<P> | null>;
  readonly failure: Ref<ReadFailure | null>;
  /** Whether what is shown is older than what is requested. */
  readonly isReading: Ref<boolean>;
  /** How far it was searched, where a limit ended the search. */
  readonly searchedToNs: Ref<bigint | null>;
  readonly damaged: Ref<readonly DamagedPart[]>;
  readonly again: () => void;
}

interface Target {
  readonly series: Series;
  readonly atNs: bigint;
}

/** Follows the play head. `onShown` is called before a product replaces the one before. */
export function useMessageAt<P extends ProductName>(
  series: () => Series | undefined,
  product: P,
  priority: () => number,
): MessageAtTime<P> {
  const { clock, sources } = useViewer();
  const shown = shallowRef<ShownMessage<P> | null>(null) as ShallowRef<ShownMessage<P> | null>;
  const failure = shallowRef<ReadFailure | null>(null);
  const isReading = ref(false);
  const searchedToNs = shallowRef<bigint | null>(null);
  const damaged = shallowRef<readonly DamagedPart[]>([]);
  let shownOf = "";
  let running: { readonly target: Target; readonly controller: AbortController } | null = null;

  async function show({ series: source, atNs }: Target, signal: AbortSignal): Promise<void> {
    const key = `${source.recording} ${source.topic}`;
    const shownNs = shownOf === key ? (shown.value?.logTimeNs ?? null) : null;
    const request = { which: "valid", atNs, product, shownNs, maxBytes: MAX_SEARCH_BYTES } as const;
    const answer = await sources.message(source, request, { signal, priority: priority() });
    failure.value = null;
    searchedToNs.value = answer.searchedToNs;
    damaged.value = answer.damaged;
    if (answer.message !== null && answer.message.logTimeNs === shownNs) return;
    shownOf = key;
    shown.value = answer.message as ShownMessage<P> | null;
  }

  const ask = latest(async (target: Target) => {
    const controller = new AbortController();
    running = { target, controller };
    isReading.value = true;
    const release = clock.wait();
    try {
      await show(target, controller.signal);
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (failed.code !== "cancelled") [failure.value, shown.value] = [failed, null];
    } finally {
      release();
      running = null;
      isReading.value = false;
    }
  });

  function follow(): void {
    const source = series();
    if (source === undefined) return;
    const atNs = clock.timeNs.value;
    if (running !== null && (running.target.series.topic !== source.topic || areFar(running.target.atNs, atNs))) running.controller.abort();
    ask({ series: source, atNs });
  }

  watch([clock.timeNs, () => `${series()?.recording} ${series()?.topic}`], follow, { immediate: true });
  onScopeDispose(() => running?.controller.abort());
  return { shown, failure, isReading, searchedToNs, damaged, again: follow };
}
