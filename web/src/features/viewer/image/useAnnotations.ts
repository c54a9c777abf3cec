// The annotations of a picture: those with its stamp, or else those that are valid at its time.
import { onScopeDispose, shallowRef, watch, type Ref, type ShallowRef } from "vue";
import type { Series } from "../layout";
import { MAX_SEARCH_BYTES, useViewer } from "../viewer";
import { latest } from "@/features/file/viewer/useReader";
import { failureOf, type ReadFailure } from "@/recordings/failures";
import type { Annotations } from "@/recordings/pictures/annotations";

/** The picture that is shown. */
export interface AnnotatedPicture {
  readonly logTimeNs: bigint;
  readonly stampSeconds: number | null;
}

export interface ShownAnnotations extends Annotations {
  readonly logTimeNs: bigint;
  /** The log time of the picture that they belong to. */
  readonly ofNs: bigint;
}

export interface AnnotationsRead {
  /** Null where there are none at or before the time. */
  readonly shown: ShallowRef<ShownAnnotations | null>;
  readonly failure: Ref<ReadFailure | null>;
}

interface Target extends AnnotatedPicture {
  readonly series: Series;
}

/** Whoever finds something in a picture publishes it within this time. */
const LATER_NS = 1_000_000_000n;
const LATER_MESSAGES = 50;
const LATER_BYTES = 2 * 2 ** 20;
/** Pictures that are further apart do not show the same. */
const FAR_NS = 1_000_000_000n;
/** Stamps that are doubles of seconds differ by less. */
const SAME_SECONDS = 1e-6;

function isFar(oneNs: bigint, otherNs: bigint): boolean {
  return oneNs - otherNs > FAR_NS || otherNs - oneNs > FAR_NS;
}

/** Follows the topic of the annotations and the picture. */
export function useAnnotations(series: () => Series | null, picture: () => AnnotatedPicture | null, priority: () => number): AnnotationsRead {
  const { sources } = useViewer();
  const shown = shallowRef<ShownAnnotations | null>(null);
  const failure = shallowRef<ReadFailure | null>(null);
  let controller = new AbortController();

  async function withSameStamp({ series: source, logTimeNs, stampSeconds }: Target, signal: AbortSignal): Promise<ShownAnnotations | null> {
    if (stampSeconds === null) return null;
    const toNs = logTimeNs + LATER_NS;
    for (const file of sources.filesOf(source).filter(({ span }) => span.fromNs <= toNs && span.toNs >= logTimeNs)) {
      const request = { product: "annotations", fromNs: logTimeNs, toNs, maxMessages: LATER_MESSAGES, maxBytes: LATER_BYTES } as const;
      const answer = await sources.messages(file, source, request, { signal, priority: priority() });
      const match = answer?.messages.find(({ product }) => Math.abs((product?.stampSeconds ?? Number.NaN) - stampSeconds) < SAME_SECONDS);
      if (match?.product) return { ...match.product, logTimeNs: match.logTimeNs, ofNs: logTimeNs };
    }
    return null;
  }

  async function validAt({ series: source, logTimeNs }: Target, signal: AbortSignal): Promise<ShownAnnotations | null> {
    const request = { which: "valid", atNs: logTimeNs, product: "annotations", shownNs: null, maxBytes: MAX_SEARCH_BYTES } as const;
    const { message } = await sources.message(source, request, { signal, priority: priority() });
    return message?.product ? { ...message.product, logTimeNs: message.logTimeNs, ofNs: logTimeNs } : null;
  }

  const ask = latest(async (target: Target) => {
    const own = controller;
    try {
      const match = (await withSameStamp(target, own.signal)) ?? (await validAt(target, own.signal));
      if (own === controller) [shown.value, failure.value] = [match, null];
    } catch (thrown) {
      const failed = failureOf(thrown, "worker_ended");
      if (own === controller && failed.code !== "cancelled") [shown.value, failure.value] = [null, failed];
    }
  });

  function follow(): void {
    const [source, target] = [series(), picture()];
    if (shown.value !== null && target !== null && isFar(shown.value.ofNs, target.logTimeNs)) {
      // What belongs to another picture is not drawn over this one until its own is read.
      controller.abort();
      controller = new AbortController();
      shown.value = null;
    }
    if (source !== null && target !== null) ask({ series: source, ...target });
  }

  function restart(): void {
    controller.abort();
    controller = new AbortController();
    [shown.value, failure.value] = [null, null];
    follow();
  }

  watch(() => `${series()?.recording} ${series()?.topic}`, restart, { immediate: true });
  watch(picture, follow);
  onScopeDispose(() => controller.abort());
  return { shown, failure };
}
