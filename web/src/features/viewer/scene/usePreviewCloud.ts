// The thinned cloud of a preview: shown until the message at the play head is read, or where it cannot be read.
import { computed, onScopeDispose, ref, shallowRef, watch, type ComputedRef } from "vue";
import type { Series } from "../layout";
import type { MessageAtTime } from "../useMessageAt";
import { areFar, useViewer } from "../viewer";
import { secondsOfNs, type TimedScene } from "./placement";
import { latest } from "@/features/file/viewer/useReader";
import { pointSetOf } from "@/recordings/geometry/points";
import { IDENTITY } from "@/recordings/geometry/poses";
import type { PreviewCloud, PreviewFile } from "@/recordings/preview_file";

/** Over a fast line, messages come before that, and no cloud of a preview flickers. */
export const DELAY_MS = 150;

interface Loaded {
  /** The time of the play head for which it is the last cloud. */
  readonly atNs: bigint;
  readonly scene: TimedScene;
}

/** Where a preview has a cloud. */
interface Place {
  readonly preview: PreviewFile;
  readonly timeNs: bigint;
}

/** Returns the last cloud of the previews at or before the play head, while the messages have nothing better; else null. */
export function usePreviewCloud(series: () => Series, { shown, failure, isReading, searchedToNs }: MessageAtTime<"scene">): ComputedRef<TimedScene | null> {
  const { clock, sources, previews } = useViewer();
  const loaded = shallowRef<Loaded | null>(null);
  const isLate = ref(false);
  let timer: ReturnType<typeof setTimeout> | undefined;

  /** Whether the message at the play head is not there (yet). While playing, messages come somewhat late. */
  const isDue = computed(() => {
    if (failure.value !== null) return true;
    if (shown.value === null) return isReading.value || searchedToNs.value !== null;
    return isReading.value && areFar(shown.value.logTimeNs, clock.timeNs.value);
  });

  const load = latest(async (atNs: bigint) => {
    const last = await lastCloud(atNs);
    const before = loaded.value?.scene;
    const scene = before !== undefined && before.logTimeNs === last?.timeNs ? before : await sceneAt(last);
    loaded.value = scene === null ? null : { atNs, scene };
  });

  async function sceneAt(place: Place | null): Promise<TimedScene | null> {
    const cloud = await place?.preview.cloud(series().topic, place.timeNs).catch(() => null);
    return cloud ? sceneOf(cloud) : null;
  }

  /** A preview that cannot be read is as good as none. */
  async function lastCloud(atNs: bigint): Promise<Place | null> {
    const files = sources.recordings.find(({ key }) => key === series().recording)?.files ?? [];
    for (const file of files.filter(({ span }) => span.fromNs <= atNs).toReversed()) {
      const preview = await previews.of(file.id).catch(() => null);
      const timeNs = timesOf(preview, series().topic).findLast((time) => time <= atNs);
      if (preview !== null && timeNs !== undefined) return { preview, timeNs };
    }
    return null;
  }

  watch(isDue, (due) => {
    clearTimeout(timer);
    isLate.value = false;
    if (due) timer = setTimeout(() => (isLate.value = true), DELAY_MS);
  }, { immediate: true });
  watch([isLate, clock.timeNs], () => isLate.value && load(clock.timeNs.value));
  onScopeDispose(() => clearTimeout(timer));

  return computed(() => {
    const now = clock.timeNs.value;
    if (!isDue.value || !isLate.value || loaded.value === null || areFar(loaded.value.atNs, now)) return null;
    const { scene } = loaded.value;
    const isBetter = shown.value === null || shown.value.logTimeNs > now || shown.value.logTimeNs < scene.logTimeNs;
    return isBetter && scene.logTimeNs <= now ? scene : null;
  });
}

function timesOf(preview: PreviewFile | null, topic: string): readonly bigint[] {
  try {
    return preview?.cloudTimes(topic) ?? [];
  } catch {
    return []; // its index is damaged
  }
}

/** Returns a cloud as a message has it. A preview has no stamps: the log time is used instead. */
function sceneOf({ timeNs, frame, totalPoints, xyz }: PreviewCloud): TimedScene {
  const column = (axis: number) => Float64Array.from({ length: xyz.length / 3 }, (_, place) => xyz[3 * place + axis] ?? Number.NaN);
  const points = pointSetOf({ x: column(0), y: column(1), z: column(2), channels: [], colours: null }, totalPoints);
  const content = { kind: "points", points, pose: IDENTITY } as const;
  return { logTimeNs: timeNs, logSeconds: secondsOfNs(timeNs), scene: { frame, stampSeconds: null, content } };
}
