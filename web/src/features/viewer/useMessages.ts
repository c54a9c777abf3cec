// The messages of a topic from some time on, page by page, as far as the play head has come.
import { computed, onScopeDispose, ref, shallowRef, watch, type ComputedRef, type Ref } from "vue";
import type { Series } from "./layout";
import { useViewer } from "./viewer";
import { failureOf, type ReadFailure } from "@/recordings/failures";
import type { Span } from "@/recordings/formats/recording";
import type { ProductName, ReadMessage } from "@/recordings/products/products";

export interface MessagesRead<P extends ProductName> {
  readonly messages: Ref<readonly ReadMessage<P>[]>;
  /** What was read; null at first. */
  readonly read: Ref<Span | null>;
  readonly isWhole: ComputedRef<boolean>;
  readonly isReading: Ref<boolean>;
  readonly failure: Ref<ReadFailure | null>;
  readonly readOn: () => void;
}

const PAGE_MESSAGES = 1_000;
const PAGE_BYTES = 4 * 2 ** 20;
/** Pages that are read unasked to come to the play head; then reading begins anew shortly before it. */
const MAX_PAGES = 4;
const MAX_MESSAGES = 20_000;
/** How long before the play head reading begins; a shorter time, where that is too much. */
const BEFORE_NS = [5_000_000_000n, 500_000_000n, 50_000_000n] as const;
const AHEAD_NS = 2_000_000_000n;
/** Lists come after what is valid at the play head, and before curves. */
const AFTER_MESSAGES = 500;

/** Follows a series and the play head. */
export function useMessages<P extends ProductName>(series: () => Series | undefined, product: P, priority: () => number): MessagesRead<P> {
  const { clock, sources } = useViewer();
  const messages = shallowRef<readonly ReadMessage<P>[]>([]);
  const read = shallowRef<Span | null>(null);
  const failure = shallowRef<ReadFailure | null>(null);
  const isReading = ref(false);
  let controller = new AbortController();

  const files = computed(() => sources.recordings.find(({ key }) => key === series()?.recording)?.files ?? []);
  const endNs = computed(() => files.value.reduce((latest, { span }) => (span.toNs > latest ? span.toNs : latest), 0n));
  const isWhole = computed(() => read.value !== null && read.value.toNs >= endNs.value && read.value.fromNs <= (files.value[0]?.span.fromNs ?? 0n));

  function isBehind(timeNs: bigint): boolean {
    return files.value.length > 0 && read.value !== null && read.value.toNs < endNs.value && read.value.toNs < timeNs;
  }

  /** Reads one page behind what was read. */
  async function readPage(signal: AbortSignal): Promise<void> {
    const [source, now] = [series(), read.value];
    const file = files.value.find(({ span }) => now !== null && span.toNs > now.toNs);
    if (source === undefined || now === null || file === undefined) return;
    const next = now.toNs + 1n;
    const fromNs = next > file.span.fromNs ? next : file.span.fromNs;
    const request = { product, fromNs, toNs: file.span.toNs, maxMessages: PAGE_MESSAGES, maxBytes: PAGE_BYTES };
    const answer = await sources.messages(file, source, request, { signal, priority: priority() + AFTER_MESSAGES });
    if (signal.aborted) return;
    const all = [...messages.value, ...(answer?.messages ?? [])];
    messages.value = all.slice(-MAX_MESSAGES);
    const first = all.length > MAX_MESSAGES ? messages.value[0]?.logTimeNs : undefined;
    read.value = { fromNs: first ?? now.fromNs, toNs: answer?.untilNs ?? file.span.toNs };
  }

  function begin(fromNs: bigint): void {
    controller.abort();
    controller = new AbortController();
    isReading.value = false;
    messages.value = [];
    read.value = { fromNs, toNs: fromNs - 1n };
    void readTo(clock.timeNs.value);
  }

  async function readTo(timeNs: bigint, minPages = 0): Promise<void> {
    if (isReading.value) return;
    const { signal } = controller;
    isReading.value = true;
    failure.value = null;
    try {
      for (let pages = 0; pages < minPages || (isBehind(timeNs) && pages < MAX_PAGES); pages += 1) await readPage(signal);
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (failed.code !== "cancelled") failure.value = failed;
    } finally {
      if (!signal.aborted) isReading.value = false;
    }
    if (!signal.aborted && failure.value === null) approach(clock.timeNs.value);
  }

  /** Goes on where the play head was not reached: from a time that is nearer to it, else from where reading ended. */
  function approach(headNs: bigint): void {
    const fromNs = read.value?.fromNs;
    if (fromNs === undefined || !isBehind(headNs)) return;
    const beforeNs = BEFORE_NS.find((length) => 2n * length <= headNs - fromNs);
    if (beforeNs === undefined) void readTo(headNs);
    else begin(headNs - beforeNs);
  }

  function follow(timeNs: bigint): void {
    if (read.value === null || failure.value !== null) return;
    if (timeNs < read.value.fromNs) begin(timeNs - BEFORE_NS[0]);
    else if (isBehind(timeNs + AHEAD_NS)) void readTo(timeNs + AHEAD_NS);
  }

  watch(() => `${series()?.recording} ${series()?.topic}`, () => begin(files.value[0]?.span.fromNs ?? 0n), { immediate: true });
  watch(clock.timeNs, follow);
  onScopeDispose(() => controller.abort());
  return { messages, read, isWhole, isReading, failure, readOn: () => void readTo(clock.timeNs.value, 1) };
}
