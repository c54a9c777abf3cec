// The address of a video or sound for a media element, which reads it by ranges; an expired one is renewed.
import { onMounted, ref, shallowRef, type Ref } from "vue";
import { previewAddress } from "./useRanges";
import { failureOf, type ReadFailure } from "@/recordings/failures";
import type { Address } from "@/recordings/ranges";

/** An address that failed sooner was not refused because it expired. */
const RENEW_BEFORE_MS = 30_000;

export interface Media {
  readonly address: Readonly<Ref<string | undefined>>;
  readonly failure: Readonly<Ref<ReadFailure | null>>;
  /** Whether the browser cannot play it. */
  readonly isUnplayable: Readonly<Ref<boolean>>;
  readonly load: () => Promise<void>;
  readonly onError: (event: Event) => void;
}

/** `request` returns an address of a file. */
export function useMedia(fileId: string, request: (fileId: string) => Promise<Address> = previewAddress): Media {
  const address = shallowRef<string>();
  const failure = shallowRef<ReadFailure | null>(null);
  const isUnplayable = ref(false);
  let expiresAtMs = 0;

  async function load(): Promise<void> {
    failure.value = null;
    try {
      const renewed = await request(fileId);
      expiresAtMs = renewed.expiresAtMs;
      address.value = renewed.url;
    } catch (thrown) {
      failure.value = failureOf(thrown, "link_refused");
    }
  }

  async function renew(element: HTMLMediaElement): Promise<void> {
    const { currentTime, paused } = element;
    element.addEventListener("loadedmetadata", () => {
      element.currentTime = currentTime;
      if (!paused) void element.play().catch(() => undefined); // a browser that refuses leaves it paused
    }, { once: true });
    await load();
  }

  function onError({ target }: Event): void {
    if (!(target instanceof HTMLMediaElement)) return;
    if (Date.now() > expiresAtMs - RENEW_BEFORE_MS) void renew(target);
    else isUnplayable.value = true;
  }

  onMounted(load);
  return { address, failure, isUnplayable, load, onError };
}
