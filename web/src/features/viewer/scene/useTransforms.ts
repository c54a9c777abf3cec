// The transforms around the play head: static ones of the whole recordings, others of some seconds.
import { onScopeDispose, ref, shallowRef, watch, type Ref } from "vue";
import type { Series } from "../layout";
import { areFar, useViewer } from "../viewer";
import { readPages } from "./pages";
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

/** What is read before the play head; a shorter time, where that is too much. */
const BEFORE_NS = [1_000_000_000n, 100_000_000n, 0n] as const;
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
  const ending = new AbortController();
  /** Ends what is read around a time, from which the play head has jumped away. */
  let moving = new AbortController();
  let covered: Span | null = null;
  let hasStatics = false;
  let isExtended = false;
  /** The transforms of another time place what is shown until those of this time come, so that the camera stays. */
  let isOutdated = false;
  let offset = 0;

  /** Returns up to where it read. */
  async function read(series: Series, { fromNs, toNs }: Span, maxBytes: number, signal: AbortSignal): Promise<bigint> {
    const request = { product: "transforms", fromNs, toNs, maxMessages: MAX_MESSAGES, maxBytes } as const;
    const isStatic = isStaticTopic(series.topic);
    const untilNs = await readPages(sources, series, request, { signal, priority: priority() }, ({ logTimeNs, product }) => {
      const logSeconds = secondsOfNs(logTimeNs);
      if (!isStatic) dropOutdated();
      for (const transform of product ?? []) {
        if (transform.stampSeconds !== null && !isStatic) offset = transform.stampSeconds - logSeconds;
        buffer.add(transform, isStatic, logSeconds);
      }
    });
    version.value += 1;
    return untilNs;
  }

  function dropOutdated(): void {
    if (isOutdated) buffer.clearDynamic();
    isOutdated = false;
  }

  async function readStatics(): Promise<void> {
    if (hasStatics) return;
    for (const series of statics) await read(series, clock.span, MAX_STATIC_BYTES, ending.signal);
    hasStatics = true;
  }

  /** Returns up to where it read all topics. */
  async function readSpan(span: Span, signal: AbortSignal): Promise<bigint> {
    let untilNs = span.toNs;
    for (const series of dynamics) {
      const reached = await read(series, span, MAX_BYTES, signal);
      if (reached < untilNs) untilNs = reached;
    }
    return untilNs;
  }

  /** Reads on after what is covered, or anew around a time that this does not reach. */
  async function cover(atNs: bigint, signal: AbortSignal): Promise<void> {
    const toNs = atNs + AHEAD_NS;
    if (covered !== null && atNs >= covered.fromNs && atNs <= covered.toNs + AHEAD_NS) {
      covered = { fromNs: covered.fromNs, toNs: await readSpan({ fromNs: covered.toNs + 1n, toNs }, signal) };
      if (covered.toNs >= atNs) return;
    }
    for (const beforeNs of BEFORE_NS) {
      [covered, isExtended, isOutdated] = [null, false, true];
      const fromNs = atNs - beforeNs;
      const untilNs = await readSpan({ fromNs, toNs }, signal);
      dropOutdated();
      covered = { fromNs, toNs: untilNs };
      if (untilNs >= atNs) return;
    }
  }

  const follow = latest(async (atNs: bigint) => {
    if (all.length === 0 || !lacks(covered, atNs)) return;
    isReading.value = true;
    const { signal } = moving;
    try {
      await readStatics();
      await cover(atNs, signal);
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
      await readSpan({ fromNs: fromNs - FAR_BEFORE_NS, toNs: fromNs - 1n }, moving.signal);
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (failed.code !== "cancelled") failure.value = failed;
    }
  }

  watch(clock.timeNs, (atNs, before = atNs) => {
    if (areFar(before, atNs)) {
      moving.abort();
      moving = new AbortController();
    }
    follow(atNs);
  }, { immediate: true });
  watch(() => isLacking.value && !isReading.value, (isDue) => {
    if (isDue) void extend();
  });
  onScopeDispose(() => [ending, moving].forEach((controller) => controller.abort()));
  return { buffer, version, failure, isReading, stampOffset: () => offset };
}

/** Whether the transforms around a time are not read, or end soon after it. */
function lacks(covered: Span | null, atNs: bigint): boolean {
  return covered === null || atNs < covered.fromNs || atNs > covered.toNs - AHEAD_NS / 2n;
}
