/** The reading worker of one recording. The bytes are untrusted, so the worker has no credential but the URL of the file. */

import { failureOf, ReadFailure } from "./failures";
import { openRecording } from "./formats/open";
import { checkCompressed } from "./pictures/picture";
import { pixelsOf } from "./pictures/pixels";
import type { Answer, FromWorker, RecordingFile, Request, RequestKind, Requests, ShownPicture, ToWorker } from "./protocol";
import { Ranges, type Address } from "./ranges";
import { Session, type Observer, type PictureMessage } from "./session";
import { makeSlice } from "./slices/make_slice";

const REPORT_EVERY_MS = 200;

// The DOM types lack the scope of a worker; these are the members used here.
const scope = self as unknown as {
  postMessage: (message: FromWorker, transfer?: Transferable[]) => void;
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null;
};

const running = new Map<number, AbortController>();
let queue: Promise<void> = Promise.resolve();
let source: Ranges | null = null;
let session: Session | null = null;
let awaitingAddress: ((message: Extract<ToWorker, { type: "address" }>) => void) | null = null;
let reportedAtMs = 0;

scope.onmessage = ({ data: message }) => {
  if (message.type === "cancel") running.get(message.id)?.abort();
  else if (message.type === "address") awaitingAddress?.(message);
  else enqueue(message.id, message.request);
};

/** Handlers by kind of request; `open` makes the session that they read. */
const handlers: {
  [K in Exclude<RequestKind, "open">]: (session: Session, request: Requests[K]["request"], observer: Observer) => Promise<Answer<K>>;
} = {
  picture: async (session, request) => bitmapOf(await session.picture(request)),
  fields: (session, { topic }) => session.fields(topic),
  curves: (session, request, observer) => session.curves(request, observer),
  slice: (session, request, observer) => makeSlice(session.recording, request, observer),
};

function enqueue(id: number, request: Request): void {
  const controller = new AbortController();
  running.set(id, controller);
  queue = queue.then(() => respond(id, request, controller.signal)).finally(() => running.delete(id));
}

async function respond(id: number, request: Request, signal: AbortSignal): Promise<void> {
  try {
    if (signal.aborted) throw new ReadFailure("cancelled");
    const answer = request.kind === "open" ? await open(request, signal) : await handle(id, request, signal);
    scope.postMessage({ type: "answer", id, answer }, "bitmap" in answer ? [answer.bitmap] : []);
  } catch (thrown) {
    const { code, detail } = failureOf(thrown, "chunk_damaged");
    scope.postMessage({ type: "failure", id, code, detail });
  } finally {
    reportBytesRead();
  }
}

async function open({ format, sizeBytes }: RecordingFile, signal: AbortSignal): Promise<Answer<"open">> {
  source = new Ranges({ sizeBytes, renew, onBytes });
  source.signal = signal;
  session = new Session(await openRecording(format, source));
  return session.opened();
}

function handle(id: number, request: Exclude<Request, { kind: "open" }>, signal: AbortSignal): Promise<Answer> {
  if (session === null || source === null) throw new ReadFailure("worker_ended");
  source.signal = signal;
  const observer: Observer = {
    signal,
    onCurves: (curves) => scope.postMessage({ type: "progress", id, curves }),
    onSliced: (progress) => scope.postMessage({ type: "sliced", id, progress }),
  };
  return handlers[request.kind](session, request as never, observer);
}

async function bitmapOf({ logTimeNs, picture, damaged }: PictureMessage): Promise<ShownPicture> {
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
  if (Date.now() - reportedAtMs > REPORT_EVERY_MS) reportBytesRead();
}

function reportBytesRead(): void {
  reportedAtMs = Date.now();
  scope.postMessage({ type: "read", bytes: source?.bytesRead ?? 0 });
}
