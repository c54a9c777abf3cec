// What is on the screen, and what the browser shows of bytes.
import { onScopeDispose, ref, shallowRef, watch, type Ref } from "vue";

/** How far below the visible part of the page something counts as seen. */
const MARGIN = "300px";

/** Returns whether an element has come into sight, or nearly so; from then on, true. */
export function useSeen(element: Readonly<Ref<HTMLElement | null>>): Readonly<Ref<boolean>> {
  const isSeen = ref(false);
  const observer = new IntersectionObserver(
    (entries) => {
      if (!entries.some(({ isIntersecting }) => isIntersecting)) return;
      isSeen.value = true;
      observer.disconnect();
    },
    { rootMargin: MARGIN },
  );
  watch(element, (now) => now && !isSeen.value && observer.observe(now));
  onScopeDispose(() => observer.disconnect());
  return isSeen;
}

/** Rows that a list scrolls past load nothing. */
const SETTLE_MS = 120;

/** Returns whether a row has shown the same object for a moment: while a list is scrolled, it shows one after the other. */
export function useSettled(id: () => string): () => boolean {
  const settledId = ref("");
  watch(
    id,
    (now, _, onCleanup) => {
      const timer = setTimeout(() => (settledId.value = now), SETTLE_MS);
      onCleanup(() => clearTimeout(timer));
    },
    { immediate: true },
  );
  return () => settledId.value === id();
}

/** Returns an address of bytes in this page for an `<img>`; null where there are none. */
export function useObjectUrl(bytes: () => Blob | null | undefined): Readonly<Ref<string | null>> {
  const address = shallowRef<string | null>(null);

  function release(): void {
    if (address.value !== null) URL.revokeObjectURL(address.value);
    address.value = null;
  }

  watch(
    bytes,
    (now) => {
      release();
      if (now) address.value = URL.createObjectURL(now);
    },
    { immediate: true },
  );
  onScopeDispose(release);
  return address;
}
