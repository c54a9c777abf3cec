// The transforms around the play head: static ones of the whole recordings, others of some seconds.
import { onScopeDispose, ref, shallowRef, watch, type Ref } from "vue";
import type { Series } from "../layout";
import { useViewer } from "../viewer";
import { secondsOfNs } from "./placement";
import { latest } from "@/features/file/viewer/useReader";
import { failureOf, type ReadFailure } from "@/recordings/failures";
import type { Span } from "@/recordings/formats/recording";
import { TransformBuffer } from "@/recordings/geometry/transform_buffer";
import { isStaticTopic, isTransformType } from "@/recordings/geometry/transforms";

export interface Transforms {
  readonly buffer: TransformBuffer;
  /** Changes with what is in the buffer. */
  readonly version: Ref<number>;
  readonly failure: Ref<ReadFailure | null>;
  readonly isReading: Ref<boolean>;
  /** How much later the stamps are than the log times, in seconds. */
  readonly stampOffset: () => number;
}

const BEFORE_NS = 1_000_000_000n;
const AHEAD_NS = 1_000_000_000n;
/** A transform that is published less often is searched for so far back. */
const FAR_BEFORE_NS = 12_000_000_000n;
const MAX_BYTES = 8 * 2 ** 20;
const MAX_STATIC_BYTES = 16 * 2 ** 20;
const MAX_MESSAGES = 5_000;

/** Follows the play head. `isLacking`: frames that are shown have no transform yet. */
export function useTransforms(priority: () => number, isLacking: Readonly<Ref<boolean>>): Transforms {
  const { clock, sources, topics } = useViewer();
  const buffer = new TransformBuffer();
  const version = ref(0);
  const failure = shallowRef<ReadFailure | null>(null);
  const isReading = ref(false);
  const all = topics.filter(({ messageType, count }) => isTransformType(messageType) && count !== 0).map(({ recording, name }): Series => ({ recording, topic: name, fields: [] }));
  const statics = all.filter(({ topic }) => isStaticTopic(topic));
  const dynamics = all.filter(({ topic }) => !isStaticTopic(topic));
  const controller = new AbortController();
  let covered: Span | null = null;
  let hasStatics = false;
  let isExtended = false;
  let offset = 0;

  async function read(series: Series, { fromNs, toNs }: Span, maxBytes: number): Promise<void> {
    const files = sources.filesOf(series).filter(({ span }) => span.fromNs <= toNs && span.toNs >= fromNs);
    for (const file of files) {
      const request = { product: "transforms", fromNs, toNs, maxMessages: MAX_MESSAGES, maxBytes } as const;
      const answer = await sources.messages(file, series, request, { signal: controller.signal, priority: priority() });
      for (const { logTimeNs, product } of answer?.messages ?? []) {
        for (const transform of product ?? []) {
          const logSeconds = secondsOfNs(logTimeNs);
          if (transform.stampSeconds !== null && !isStaticTopic(series.topic)) offset = transform.stampSeconds - logSeconds;
          buffer.add(transform, isStaticTopic(series.topic), logSeconds);
        }
      }
    }
    version.value += 1;
  }

  async function readStatics(): Promise<void> {
    if (hasStatics) return;
    hasStatics = true;
    for (const series of statics) await read(series, clock.span, MAX_STATIC_BYTES);
  }

  async function readSpan(span: Span): Promise<void> {
    if (span.toNs < span.fromNs) return;
    for (const series of dynamics) await read(series, span, MAX_BYTES);
  }

  const follow = latest(async (atNs: bigint) => {
    if (all.length === 0 || !lacks(covered, atNs)) return;
    isReading.value = true;
    try {
      await readStatics();
      const isNear = covered !== null && atNs >= covered.fromNs && atNs <= covered.toNs + AHEAD_NS;
      if (!isNear) buffer.clearDynamic();
      const span = { fromNs: isNear && covered !== null ? covered.toNs + 1n : atNs - BEFORE_NS, toNs: atNs + AHEAD_NS };
      await readSpan(span);
      covered = { fromNs: isNear && covered !== null ? covered.fromNs : span.fromNs, toNs: span.toNs };
      isExtended &&= isNear;
      failure.value = null;
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (failed.code !== "cancelled") failure.value = failed;
    } finally {
      isReading.value = false;
    }
  });

  /** Search further back, once after each jump. */
  async function extend(): Promise<void> {
    if (covered === null || isExtended) return;
    isExtended = true;
    const { fromNs } = covered;
    try {
      await readSpan({ fromNs: fromNs - FAR_BEFORE_NS, toNs: fromNs - 1n });
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (failed.code !== "cancelled") failure.value = failed;
    }
  }

  watch(clock.timeNs, (atNs) => follow(atNs), { immediate: true });
  watch(() => isLacking.value && !isReading.value, (isDue) => {
    if (isDue) void extend();
  });
  onScopeDispose(() => controller.abort());
  return { buffer, version, failure, isReading, stampOffset: () => offset };
}

/** Whether the transforms around a time are not read, or end soon after it. */
function lacks(covered: Span | null, atNs: bigint): boolean {
  return covered === null || atNs < covered.fromNs || atNs > covered.toNs - AHEAD_NS / 2n;
}
