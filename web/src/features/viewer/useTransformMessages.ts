// The transforms of a recording around the play head, and its static ones.
import { onScopeDispose, ref, shallowRef, watch, type Ref } from "vue";
import type { TransformMessage } from "./frame_tree";
import type { Series } from "./layout";
import { readPages } from "./scene/pages";
import { useViewer } from "./viewer";
import { latest } from "@/features/file/viewer/useReader";
import { failureOf, type ReadFailure } from "@/recordings/failures";
import type { Span } from "@/recordings/formats/recording";
import { isStaticTopic, isTransformType } from "@/recordings/geometry/transforms";

export interface TransformMessagesRead {
  readonly messages: Ref<readonly TransformMessage[]>;
  readonly isReading: Ref<boolean>;
  readonly failure: Ref<ReadFailure | null>;
  readonly again: () => void;
}

/** What is read around the play head; a shorter time, where that is too much. */
const BEFORE_NS = [10_000_000_000n, 1_000_000_000n, 100_000_000n] as const;
const BEHIND_NS = 1_000_000_000n;
const PAGE_MESSAGES = 2_000;
const PAGE_BYTES = 4 * 2 ** 20;
const MAX_STATIC_MESSAGES = 1_000;
/** What remains in memory while the play head moves forward. */
const MAX_MESSAGES = 10_000;
const AFTER_MESSAGES = 500;

/** Follows the topics and the play head. The static topics of their recordings are always read. */
export function useTransformMessages(series: () => readonly Series[], priority: () => number): TransformMessagesRead {
  const { clock, sources, topics } = useViewer();
  const messages = shallowRef<readonly TransformMessage[]>([]);
  const failure = shallowRef<ReadFailure | null>(null);
  const isReading = ref(false);
  let controller = new AbortController();
  let fixed: readonly TransformMessage[] | null = null;
  let moving: readonly TransformMessage[] = [];
  let read: Span | null = null;

  function staticSeries(): Series[] {
    const recordings = new Set(series().map(({ recording }) => recording));
    const all = topics.filter(({ recording, name, messageType }) => recordings.has(recording) && isStaticTopic(name) && isTransformType(messageType));
    return all.map(({ recording, name }) => ({ recording, topic: name, fields: [] }));
  }

  /** Reads messages of a part of the time; returns them, and up to where. */
  async function readTopic(source: Series, { fromNs, toNs }: Span, signal: AbortSignal): Promise<{ messages: TransformMessage[]; untilNs: bigint }> {
    const result: TransformMessage[] = [];
    const isStatic = isStaticTopic(source.topic);
    const request = { product: "transforms", fromNs, toNs, maxMessages: PAGE_MESSAGES, maxBytes: PAGE_BYTES } as const;
    const untilNs = await readPages(sources, source, request, { signal, priority: priority() + AFTER_MESSAGES }, ({ logTimeNs, product }) => {
      result.push({ timeNs: logTimeNs, isStatic, transforms: product ?? [] });
    });
    return { messages: result, untilNs };
  }

  async function readStatic(signal: AbortSignal): Promise<TransformMessage[]> {
    const all: TransformMessage[] = [];
    for (const source of staticSeries()) all.push(...(await readTopic(source, clock.span, signal)).messages);
    return all.slice(-MAX_STATIC_MESSAGES);
  }

  /** Reads what is missing in a part of the time of all topics; null where that is too much. */
  async function readMoving(part: Span, needNs: bigint, signal: AbortSignal): Promise<Span | null> {
    const all: TransformMessage[] = [];
    let { toNs } = part;
    for (const source of series().filter(({ topic }) => !isStaticTopic(topic))) {
      const answer = await readTopic(source, part, signal);
      all.push(...answer.messages);
      if (answer.untilNs < toNs) toNs = answer.untilNs;
    }
    if (toNs < needNs) return null;
    const isContinued = read !== null && read.toNs + 1n === part.fromNs;
    const merged = [...(isContinued ? moving : []), ...all.filter(({ timeNs }) => timeNs <= toNs)].toSorted((a, b) => (a.timeNs < b.timeNs ? -1 : 1));
    moving = merged.slice(-MAX_MESSAGES);
    const fromNs = isContinued && read !== null ? read.fromNs : part.fromNs;
    return { fromNs: merged.length > MAX_MESSAGES ? (moving[0]?.timeNs ?? fromNs) : fromNs, toNs };
  }

  async function readTo(timeNs: bigint, signal: AbortSignal): Promise<void> {
    fixed ??= await readStatic(signal);
    const toNs = timeNs + BEHIND_NS;
    if (read !== null && timeNs > read.toNs && timeNs - read.toNs < BEFORE_NS[0]) {
      const next = await readMoving({ fromNs: read.toNs + 1n, toNs }, timeNs, signal);
      if (next !== null) return void (read = next);
    }
    for (const beforeNs of BEFORE_NS) {
      read = null;
      read = await readMoving({ fromNs: timeNs - beforeNs, toNs }, timeNs, signal);
      if (read !== null) return;
    }
  }

  function isKnown(timeNs: bigint): boolean {
    return read !== null && timeNs >= read.fromNs && timeNs <= read.toNs;
  }

  const ask = latest(async (timeNs: bigint) => {
    if (isKnown(timeNs)) return;
    const own = controller;
    isReading.value = true;
    try {
      await readTo(timeNs, own.signal);
      if (own === controller) messages.value = [...(fixed ?? []), ...moving];
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (own === controller && failed.code !== "cancelled") failure.value = failed;
    } finally {
      isReading.value = false;
    }
  });

  function follow(timeNs: bigint): void {
    if (failure.value === null && !isKnown(timeNs)) ask(timeNs);
  }

  function restart(): void {
    controller.abort();
    controller = new AbortController();
    [fixed, moving, read] = [null, [], null];
    [failure.value, messages.value] = [null, []];
    ask(clock.timeNs.value);
  }

  watch(() => JSON.stringify(series().map(({ recording, topic }) => [recording, topic])), restart, { immediate: true });
  watch(clock.timeNs, follow);
  onScopeDispose(() => controller.abort());
  return { messages, isReading, failure, again: restart };
}
