// The messages of a topic around the play head, as rows.
import { computed, onScopeDispose, ref, shallowRef, watch, type ComputedRef, type Ref } from "vue";
import type { Series } from "./layout";
import { rowsAround, windowAround, type TableRow } from "./table_rows";
import { MAX_SEARCH_BYTES, useViewer } from "./viewer";
import { latest } from "@/features/file/viewer/useReader";
import { failureOf, type ReadFailure } from "@/recordings/failures";
import type { Span } from "@/recordings/formats/recording";

export interface RowsRead {
  /** In order of time; those around the play head. */
  readonly rows: ComputedRef<readonly TableRow[]>;
  readonly isReading: Ref<boolean>;
  readonly failure: Ref<ReadFailure | null>;
  readonly again: () => void;
}

const MAX_MESSAGES = 500;
const MAX_BYTES = 4 * 2 ** 20;
/** Further rows are read when the play head has passed this share of the known time. */
const READ_AHEAD_SHARE = 0.75;
/** And when it has gone back to this part of the time that was read before it. */
const BACK_PARTS = 3n;

/** Rows without a gap. */
interface Known extends Span {
  readonly key: string;
  /** Before this time, too few rows are before the play head. */
  readonly backNs: bigint;
  readonly rows: readonly TableRow[];
}

export function useRows(series: () => Series | undefined, priority: () => number): RowsRead {
  const { clock, sources, topics } = useViewer();
  const known = shallowRef<Known | null>(null);
  const failure = shallowRef<ReadFailure | null>(null);
  const isReading = ref(false);
  let controller = new AbortController();
  const keyOf = (source: Series | undefined): string => `${source?.recording} ${source?.topic}`;
  const own = computed(() => (known.value?.key === keyOf(series()) ? known.value : null));
  const rows = computed(() => rowsAround(own.value?.rows ?? [], clock.timeNs.value));

  function isKnown(timeNs: bigint): boolean {
    if (own.value === null) return false;
    const { fromNs, toNs, backNs } = own.value;
    const passed = Number(timeNs - fromNs) / Math.max(1, Number(toNs - fromNs));
    const hasBefore = timeNs >= backNs || fromNs <= clock.span.fromNs;
    return hasBefore && timeNs >= fromNs && timeNs <= toNs && (passed < READ_AHEAD_SHARE || toNs >= clock.span.toNs);
  }

  /** Reads messages of a part of the time, from one file after the other. */
  async function readSpan(source: Series, part: Span, signal: AbortSignal): Promise<Known> {
    const read: TableRow[] = [];
    let { toNs } = part;
    for (const file of sources.filesOf(source)) {
      if (file.span.toNs < part.fromNs || file.span.fromNs > toNs) continue;
      const request = { product: "plain", ...part, toNs, maxMessages: MAX_MESSAGES, maxBytes: MAX_BYTES } as const;
      const answer = await sources.messages(file, source, request, { signal, priority: priority() });
      read.push(...(answer?.messages ?? []).map(({ logTimeNs, product }) => ({ timeNs: logTimeNs, value: product })));
      if (answer !== null && answer.untilNs < toNs) toNs = answer.untilNs;
    }
    const inOrder = read.filter(({ timeNs }) => timeNs <= toNs).toSorted((a, b) => (a.timeNs < b.timeNs ? -1 : 1));
    return { key: keyOf(source), fromNs: part.fromNs, toNs, backNs: part.fromNs, rows: inOrder };
  }

  async function readAround(source: Series, timeNs: bigint, signal: AbortSignal): Promise<Known> {
    const topic = topics.find(({ recording, name }) => recording === source.recording && name === source.topic);
    const part = windowAround(timeNs, clock.span, topic?.count ?? null);
    const around = await readSpan(source, part, signal);
    if (around.rows.some((row) => row.timeNs <= timeNs) && around.toNs >= timeNs) return { ...around, backNs: part.fromNs + (timeNs - part.fromNs) / BACK_PARTS };
    // No message before the play head in this time, or too many: begin with the one that is valid.
    const request = { which: "valid", atNs: timeNs, product: "plain", shownNs: null, maxBytes: MAX_SEARCH_BYTES } as const;
    const { message } = await sources.message(source, request, { signal, priority: priority() });
    const behind = around.toNs >= timeNs ? around : await readSpan(source, { fromNs: timeNs + 1n, toNs: part.toNs }, signal);
    const first = message === null ? [] : [{ timeNs: message.logTimeNs, value: message.product }];
    const fromNs = message?.logTimeNs ?? timeNs;
    return { ...behind, fromNs, backNs: fromNs, rows: [...first, ...behind.rows] };
  }

  const ask = latest(async ({ source, timeNs }: { source: Series; timeNs: bigint }) => {
    if (isKnown(timeNs)) return;
    controller = new AbortController();
    const { signal } = controller;
    isReading.value = true;
    try {
      const next = await readAround(source, timeNs, signal);
      failure.value = null;
      known.value = next;
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (failed.code !== "cancelled") failure.value = failed;
    } finally {
      isReading.value = false;
    }
  });

  function follow(): void {
    const source = series();
    if (source !== undefined && failure.value === null && !isKnown(clock.timeNs.value)) ask({ source, timeNs: clock.timeNs.value });
  }

  function restart(): void {
    failure.value = null;
    follow();
  }

  watch(clock.timeNs, follow);
  watch(() => keyOf(series()), restart, { immediate: true });
  onScopeDispose(() => controller.abort());
  return { rows, isReading, failure, again: restart };
}
