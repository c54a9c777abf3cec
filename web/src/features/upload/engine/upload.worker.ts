// The worker that runs uploads, so that hashing does not block the page and background tabs are not throttled.

import { UploadQueue } from "./uploadQueue";
import { realClock } from "./flow";
import { httpApi } from "./api";
import { MemoryJournal, openJournal, type Journal } from "./journal";
import type { Command } from "./types";
import { realStore } from "./store";

async function alone(name: string, run: () => Promise<void>): Promise<boolean> {
  // Only where the page came safely (https, or this machine) do tabs have locks; elsewhere the server's lease decides.
  if (!("locks" in navigator)) {
    await run();
    return true;
  }
  return navigator.locks.request(name, { ifAvailable: true }, async (lock) => {
    if (lock !== null) await run();
    return lock !== null;
  });
}

async function openOrMemory(): Promise<Journal> {
  try {
    return await openJournal();
  } catch {
    return new MemoryJournal();
  }
}

const queue = openOrMemory().then(
  (journal) =>
    new UploadQueue({
      api: httpApi(self.location.origin),
      store: realStore,
      journal,
      clock: realClock,
      report: (report) => self.postMessage(report),
      alone,
    }),
);

self.addEventListener("message", ({ data }: MessageEvent<Command>) => {
  void queue.then((at) => {
    if (data.kind === "start") return at.start(data.head, data.files);
    if (data.kind === "pause") at.pause(data.id);
    if (data.kind === "go_on") at.resume(data.id);
    if (data.kind === "cancel") at.cancel(data.id);
    return undefined;
  });
});
self.addEventListener("online", () => void queue.then((at) => at.nudge()));
