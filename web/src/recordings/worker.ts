/** The reading worker: one recording a worker. It reads a stranger's bytes, so it holds no right but the address. */

import { failureOf, ReadFailure } from "./failures";
import { openRecording } from "./formats/open";
import { checkCompressed } from "./pictures/picture";
import { pixelsOf } from "./pictures/pixels";
import type { FromWorker, Request, ShownPicture, ToWorker } from "./protocol";
import { Ranges, type Address } from "./ranges";
import { Session, type FoundPicture } from "./session";

const SAY_READ_EVERY_MS = 200;

// The DOM's types know no worker's own scope; this is what is used of it.
const scope = self as unknown as {
  postMessage: (message: FromWorker, transfer?: Transferable[]) => void;
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null;
};

const running = new Map<number, AbortController>();
let queue: Promise<void> = Promise.resolve();
let source: Ranges | null = null;
let session: Session | null = null;
let awaitingAddress: ((message: Extract<ToWorker, { type: "address" }>) => void) | null = null;
let saidAtMs = 0;

scope.onmessage = ({ data: message }) => {
  if (message.type === "cancel") running.get(message.id)?.abort();
  else if (message.type === "address") awaitingAddress?.(message);
  else ask(message.id, message.request);
};

function ask(id: number, request: Request): void {
  const controller = new AbortController();
  running.set(id, controller);
  queue = queue.then(() => answered(id, request, controller.signal)).finally(() => running.delete(id));
}

async function answered(id: number, request: Request, signal: AbortSignal): Promise<void> {
  try {
    if (signal.aborted) throw new ReadFailure("cancelled");
    await answer(id, request, signal);
  } catch (thrown) {
    const { code, detail } = failureOf(thrown, "chunk_damaged");
    scope.postMessage({ type: "failure", id, code, detail });
  } finally {
    sayRead();
  }
}

async function answer(id: number, request: Request, signal: AbortSignal): Promise<void> {
  if (request.kind === "open") {
    source = new Ranges({ sizeBytes: request.sizeBytes, renew, onBytes });
    source.signal = signal;
    session = new Session(await openRecording(request.format, source));
    scope.postMessage({ type: "answer", id, answer: session.opened() });
    return;
  }
  if (session === null || source === null) throw new ReadFailure("worker_ended");
  source.signal = signal;
  if (request.kind === "picture") {
    const shown = await bitmapOf(await session.picture(request));
    scope.postMessage({ type: "answer", id, answer: shown }, [shown.bitmap]);
  } else if (request.kind === "fields") {
    scope.postMessage({ type: "answer", id, answer: await session.fields(request.topic) });
  } else {
    const onCurves = (curves: FromWorker & { type: "progress" }): void => scope.postMessage(curves);
    const listener = { signal, onCurves: (curves: Parameters<typeof progress>[1]) => onCurves(progress(id, curves)) };
    scope.postMessage({ type: "answer", id, answer: await session.curves(request, listener) });
  }
}

function progress(id: number, curves: (FromWorker & { type: "progress" })["curves"]): FromWorker & { type: "progress" } {
  return { type: "progress", id, curves };
}

async function bitmapOf({ logTimeNs, picture, damaged }: FoundPicture): Promise<ShownPicture> {
  if (picture.kind === "raw") {
    const { width, height, rgba, range } = pixelsOf(picture);
    const bitmap = await createImageBitmap(new ImageData(rgba, width, height));
    return { logTimeNs, bitmap, width, height, encoding: picture.encoding, range, damaged };
  }
  checkCompressed(picture);
  let bitmap: ImageBitmap;
  try {
    bitmap = await createImageBitmap(new Blob([picture.data.slice()], { type: picture.mime }));
  } catch {
    throw new ReadFailure("picture_unreadable", picture.mime);
  }
  return { logTimeNs, bitmap, width: bitmap.width, height: bitmap.height, encoding: picture.mime, range: null, damaged };
}

function renew(): Promise<Address> {
  return new Promise((resolve, reject) => {
    awaitingAddress = ({ address, reason }) => {
      awaitingAddress = null;
      if (address === null) reject(new ReadFailure(reason));
      else resolve(address);
    };
    scope.postMessage({ type: "renew", id: 0 });
  });
}

function onBytes(): void {
  if (Date.now() - saidAtMs > SAY_READ_EVERY_MS) sayRead();
}

function sayRead(): void {
  saidAtMs = Date.now();
  scope.postMessage({ type: "read", bytes: source?.bytesRead ?? 0 });
}
