// What a topic of a 3D panel shows at the play head: the valid message, those that decay, or a set of markers.
import { computed, onScopeDispose, shallowRef, watch, type ComputedRef, type ShallowRef } from "vue";
import type { Series } from "../layout";
import { useMessageAt, type MessageAtTime, type ShownMessage } from "../useMessageAt";
import { useViewer } from "../viewer";
import { readPages } from "./pages";
import { secondsOfNs, type TimedScene } from "./placement";
import { latest } from "@/features/file/viewer/useReader";
import { failureOf } from "@/recordings/failures";
import { MarkerSet, type Marker } from "@/recordings/geometry/markers";
import type { ReadMessage } from "@/recordings/products/products";

export interface SceneTopicState {
  readonly message: MessageAtTime<"scene">;
  /** The latest last. */
  readonly messages: ComputedRef<readonly TimedScene[]>;
  readonly markers: ComputedRef<readonly Marker[]>;
}

/** What decays stays within these bounds. */
const MAX_DECAYING = 300;
const MAX_DECAYING_POINTS = 2_000_000;
/** Markers that were set up to so long ago are shown after a jump. */
const MARKERS_BEFORE_NS = 10_000_000_000n;
const MARKER_BYTES = 8 * 2 ** 20;
const MARKER_MESSAGES = 2_000;

export function useSceneTopic(series: () => Series, priority: () => number, decaySeconds: () => number): SceneTopicState {
  const message = useMessageAt(series, "scene", priority);
  const past = useDecay(message.shown, decaySeconds);
  const markers = useMarkers(series, message.shown, priority);
  return { message, messages: past, markers };
}

function timed({ logTimeNs, product }: ShownMessage<"scene">): TimedScene {
  return { logTimeNs, logSeconds: secondsOfNs(logTimeNs), scene: product };
}

/** Collects what was shown, and returns what has not yet decayed at the play head. */
function useDecay(shown: ShallowRef<ShownMessage<"scene"> | null>, decaySeconds: () => number): ComputedRef<readonly TimedScene[]> {
  const { clock } = useViewer();
  const collected = shallowRef<readonly TimedScene[]>([]);
  const visible = computed(() => {
    const last = collected.value.at(-1);
    if (last === undefined || decaySeconds() === 0) return collected.value.slice(-1);
    const from = secondsOfNs(clock.timeNs.value) - decaySeconds();
    return collected.value.filter((one) => one === last || one.logSeconds > from);
  });
  watch(shown, (now) => {
    if (now === null) collected.value = [];
    else if (decaySeconds() === 0) collected.value = [timed(now)];
    else {
      const from = secondsOfNs(now.logTimeNs) - decaySeconds();
      const before = collected.value.filter(({ logTimeNs, logSeconds }) => logTimeNs < now.logTimeNs && logSeconds > from);
      collected.value = withinBudget([...before, timed(now)]);
    }
  }, { immediate: true });
  return visible;
}

function withinBudget(messages: readonly TimedScene[]): readonly TimedScene[] {
  const latestFirst = messages.slice(-MAX_DECAYING).toReversed();
  let points = 0;
  const end = latestFirst.findIndex(({ scene: { content } }) => {
    points += content.kind === "points" ? content.points.positions.length / 3 : 0;
    return points > MAX_DECAYING_POINTS;
  });
  return (end < 0 ? latestFirst : latestFirst.slice(0, Math.max(1, end))).toReversed();
}

/** Applies the messages between the last one that was applied and the one that is shown, in order. */
function useMarkers(series: () => Series, shown: ShallowRef<ShownMessage<"scene"> | null>, priority: () => number): ComputedRef<readonly Marker[]> {
  const { clock, sources } = useViewer();
  const set = new MarkerSet();
  const version = shallowRef(0);
  const controller = new AbortController();
  let appliedNs: bigint | null = null;

  const apply = latest(async (now: ShownMessage<"scene"> | null) => {
    const from = now !== null && appliedNs !== null && appliedNs <= now.logTimeNs && now.logTimeNs - appliedNs < MARKERS_BEFORE_NS ? appliedNs + 1n : null;
    if (from === null) set.clear();
    if (now !== null) await applySpan(from ?? now.logTimeNs - MARKERS_BEFORE_NS, now);
    appliedNs = now?.logTimeNs ?? null;
    version.value += 1;
  });

  async function applySpan(fromNs: bigint, last: ShownMessage<"scene">): Promise<void> {
    const request = { product: "scene", fromNs, toNs: last.logTimeNs, maxMessages: MARKER_MESSAGES, maxBytes: MARKER_BYTES } as const;
    try {
      const untilNs = await readPages(sources, series(), request, { signal: controller.signal, priority: priority() }, applyMessage);
      if (untilNs >= last.logTimeNs) return;
    } catch (thrown) {
      if (failureOf(thrown, "worker_ended").code === "cancelled") return;
    }
    // Messages in between were not read, which may have deleted what was applied before them.
    set.clear();
    applyMessage(last);
  }

  function applyMessage({ logTimeNs, product }: ReadMessage<"scene">): void {
    if (product?.content.kind === "markers") set.apply(product.content.changes, secondsOfNs(logTimeNs));
  }

  watch(shown, (now) => {
    if (now === null || now.product.content.kind === "markers") apply(now);
  }, { immediate: true });
  onScopeDispose(() => controller.abort());
  const all = computed(() => (version.value === 0 ? [] : set.visibleAt(Number.NEGATIVE_INFINITY)));
  const areTemporary = computed(() => all.value.some(({ lifetimeSeconds }) => Number.isFinite(lifetimeSeconds)));
  // Only markers with a lifetime depend on the play head: others are not placed again with each of its steps.
  return computed(() => (areTemporary.value ? set.visibleAt(secondsOfNs(clock.timeNs.value)) : all.value));
}
