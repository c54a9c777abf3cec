import { expect, it, vi } from "vitest";
import { createApp } from "vue";
import { useMedia, type Media } from "./useMedia";
import { ReadFailure } from "@/recordings/failures";
import type { Address } from "@/recordings/ranges";

/** Uses media in a component; `lives`: for how long each address is valid. */
function mediaOf(lives: readonly number[]): { media: Media; requests: () => number; close: () => void } {
  let requests = 0;
  const request = (): Promise<Address> => {
    const life = lives[requests];
    requests += 1;
    if (life === undefined) return Promise.reject(new ReadFailure("link_refused"));
    return Promise.resolve({ url: `http://store.test/${requests}`, expiresAtMs: Date.now() + life });
  };
  const made: Media[] = [];
  const app = createApp({
    setup: () => {
      made.push(useMedia("1", request));
      return () => null;
    },
  });
  app.mount(document.createElement("div"));
  return { media: made[0] as Media, requests: () => requests, close: () => app.unmount() };
}

function failed(element: HTMLVideoElement): Event {
  const event = new Event("error");
  Object.defineProperty(event, "target", { value: element });
  return event;
}

it("a video goes on where it was once its address has expired", async () => {
  const { media, requests, close } = mediaOf([0, 3_600_000]);
  await vi.waitFor(() => expect(media.address.value).toBe("http://store.test/1"));
  const element = document.createElement("video");
  element.currentTime = 12;
  media.onError(failed(element));
  await vi.waitFor(() => expect(media.address.value).toBe("http://store.test/2"));
  element.currentTime = 0; // as a browser does for another address
  element.dispatchEvent(new Event("loadedmetadata"));
  expect([element.currentTime, media.isUnplayable.value]).toEqual([12, false]);
  media.onError(failed(element)); // this address is still valid
  expect([requests(), media.isUnplayable.value]).toEqual([2, true]);
  close();
});

it("a refused address is a failure with a name", async () => {
  const { media, close } = mediaOf([]);
  await vi.waitFor(() => expect(media.failure.value?.code).toBe("link_refused"));
  close();
});
