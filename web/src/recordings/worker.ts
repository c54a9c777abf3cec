/** The reading worker of one recording. The bytes are untrusted, so the worker has no credential but the URL of the file. */

import { failureOf, ReadFailure } from "./failures";
import { openRecording } from "./formats/open";
import { transferables } from "./products/products";
import type { Answer, FromWorker, RecordingFile, Request, RequestKind, Requests, ToWorker } from "./protocol";
import { Ranges, type Address } from "./ranges";
import { RequestQueue } from "./request_queue";
import { Session, yieldToEvents, type Observer } from "./session";
import { makeSlice } from "./slices/make_slice";

const REPORT_EVERY_MS = 200;

// The DOM types lack the scope of a worker; these are the members used here.
const scope = self as unknown as {
  postMessage: (message: FromWorker, transfer?: Transferable[]) => void;
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null;
};

type RequestMessage = Extract<ToWorker, { type: "request" }>;

const queue = new RequestQueue<RequestMessage>();
const running = new Map<number, AbortController>();
let isServing = false;
let source: Ranges | null = null;
let session: Session | null = null;
let awaitingAddress: ((message: Extract<ToWorker, { type: "address" }>) => void) | null = null;
let reportedAtMs = 0;

scope.onmessage = ({ data: message }) => {
  if (message.type === "cancel") cancel(message.id);
  else if (message.type === "address") awaitingAddress?.(message);
  else {
    queue.add(message);
    if (!isServing) void serveAll();
  }
};

/** Handlers by kind of request; `open` makes the session that they read. */
const handlers: {
  [K in Exclude<RequestKind, "open">]: (session: Session, request: Requests[K]["request"], observer: Observer) => Promise<Answer<K>>;
} = {
  message: (session, request, { signal }) => session.message(request, signal),
  messages: (session, request, observer) => session.messages(request, observer),
  fields: (session, { topic }) => session.fields(topic),
  curves: (session, request, observer) => session.curves(request, observer),
  slice: (session, request, observer) => makeSlice(session.recording, request, observer),
};

async function serveAll(): Promise<void> {
  isServing = true;
  for (let next = queue.take(); next !== null; next = queue.take()) await respond(next);
  isServing = false;
}

/** Serve what is more urgent than the running request, which continues afterwards. */
async function serveUrgent(limit: number, signal: AbortSignal): Promise<void> {
  await yieldToEvents();
  const ahead = source?.ahead ?? 0;
  for (let next = queue.take(limit); next !== null; next = queue.take(limit)) {
    if (source !== null) source.ahead = 0;
    await respond(next);
  }
  if (source !== null) [source.ahead, source.signal] = [ahead, signal];
  if (signal.aborted) throw new ReadFailure("cancelled");
}

function cancel(id: number): void {
  running.get(id)?.abort();
  if (queue.remove(id) !== null) scope.postMessage({ type: "failure", id, code: "cancelled", detail: "" });
}

async function respond({ id, priority, request }: RequestMessage): Promise<void> {
  const controller = new AbortController();
  running.set(id, controller);
  const { signal } = controller;
  try {
    const answer = request.kind === "open" ? await open(request, signal) : await handle(id, priority, request, signal);
    scope.postMessage({ type: "answer", id, answer }, moved(answer));
  } catch (thrown) {
    const { code, detail } = failureOf(thrown, "chunk_damaged");
    scope.postMessage({ type: "failure", id, code, detail });
  } finally {
    running.delete(id);
    reportBytesRead();
  }
}

function moved(answer: Answer): Transferable[] {
  if ("message" in answer) return transferables(answer.message?.product ?? null);
  return "messages" in answer && Array.isArray(answer.messages) ? answer.messages.flatMap(({ product }) => transferables(product)) : [];
}

async function open({ format, sizeBytes, cacheBytes }: RecordingFile, signal: AbortSignal): Promise<Answer<"open">> {
  source = new Ranges({ sizeBytes, renew, onBytes, fetchesNext: true });
  source.signal = signal;
  session = new Session(await openRecording(format, source, cacheBytes === undefined ? {} : { cacheBytes }));
  return session.opened();
}

function handle(id: number, priority: number, request: Exclude<Request, { kind: "open" }>, signal: AbortSignal): Promise<Answer> {
  if (session === null || source === null) throw new ReadFailure("worker_ended");
  source.signal = signal;
  const observer: Observer = {
    signal,
    pause: () => serveUrgent(priority, signal),
    onCurves: (curves) => scope.postMessage({ type: "progress", id, curves }),
    onSliced: (progress) => scope.postMessage({ type: "sliced", id, progress }),
  };
  return handlers[request.kind](session, request as never, observer);
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
