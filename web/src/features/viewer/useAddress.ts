// The time, the loop and the panels of the viewer in the address of the page.
import { computed, onScopeDispose, watch, type WritableComputedRef } from "vue";
import { useRoute, useRouter } from "vue-router";
import type { Clock } from "./clock";
import { panelsOf, panelText, timeOf, type Panel } from "./layout";
import { useQueryList, useQueryText } from "@/router/query";

/** The address names the time where the play head rests, and while playing the time of every second. */
const REST_MS = 300;
const PLAYING_MS = 1_000;

export interface ViewerAddress {
  readonly panels: WritableComputedRef<readonly Panel[]>;
  /** Whether the address names the panels. */
  readonly isNamed: () => boolean;
  /** Returns the whole address of what is shown now. */
  readonly link: () => string;
}

/** Returns the log time in the address; null where there is none. */
export function useAddressTime(): bigint | null {
  return timeOf(useQueryText("t").value);
}

/** Binds the clock and the panels to the address; without panels in it, `defaults` are shown. */
export function useAddress(clock: Clock, defaults: () => readonly Panel[]): ViewerAddress {
  const route = useRoute();
  const router = useRouter();
  const time = useQueryText("t");
  const loopFrom = useQueryText("from");
  const loopTo = useQueryText("to");
  const texts = useQueryList("p", "push");
  let writing: ReturnType<typeof setTimeout> | null = null;
  let written = time.value;

  /** One text, so that the panels stay the same objects while only the time in the address changes. */
  const joined = computed(() => JSON.stringify(texts.value));
  const panels = computed<readonly Panel[]>({
    get: () => {
      const own = JSON.parse(joined.value) as string[];
      return own.length === 0 ? defaults() : panelsOf(own);
    },
    set: (next) => (texts.value = next.length === 0 ? [""] : next.map(panelText)),
  });

  function writeTime(): void {
    writing = null;
    written = clock.timeNs.value.toString();
    time.value = written;
  }

  function readLoop(): void {
    const [fromNs, toNs] = [timeOf(loopFrom.value), timeOf(loopTo.value)];
    clock.setLoop(fromNs !== null && toNs !== null && fromNs < toNs ? { fromNs, toNs } : null);
  }

  readLoop();
  watch(clock.timeNs, () => {
    if (clock.isPlaying.value && writing !== null) return;
    if (writing !== null) clearTimeout(writing);
    writing = setTimeout(writeTime, clock.isPlaying.value ? PLAYING_MS : REST_MS);
  });
  watch(clock.loop, (loop) => {
    loopFrom.value = loop?.fromNs.toString() ?? "";
    loopTo.value = loop?.toNs.toString() ?? "";
  });
  watch(time, (text) => {
    const timeNs = timeOf(text);
    if (text !== written && timeNs !== null) clock.seek(timeNs);
  });
  onScopeDispose(() => writing !== null && clearTimeout(writing));

  function link(): string {
    const loop = clock.loop.value;
    const query = {
      ...route.query,
      t: clock.timeNs.value.toString(),
      from: loop?.fromNs.toString(),
      to: loop?.toNs.toString(),
      p: panels.value.map(panelText),
    };
    return new URL(router.resolve({ path: route.path, query, hash: route.hash }).href, globalThis.location.href).href;
  }

  return { panels, isNamed: () => texts.value.length > 0, link };
}
