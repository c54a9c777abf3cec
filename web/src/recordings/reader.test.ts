import { describe, expect, it, vi } from "vitest";
import type { FromWorker, ToWorker } from "./protocol";
import { RecordingReader, type WorkerLike } from "./reader";

/** A worker that does what the test says. */
class ScriptedWorker implements WorkerLike {
  onmessage: WorkerLike["onmessage"] = null;
  onerror: WorkerLike["onerror"] = null;
  onmessageerror: WorkerLike["onmessageerror"] = null;
  isEnded = false;
  readonly received: ToWorker[] = [];

  constructor(private readonly act: (worker: ScriptedWorker, message: ToWorker) => void) {}

  postMessage(message: ToWorker): void {
    this.received.push(message);
    this.act(this, message);
  }

  terminate(): void {
    this.isEnded = true;
  }

  say(message: FromWorker): void {
    queueMicrotask(() => this.onmessage?.(new MessageEvent("message", { data: message })));
  }
}

const OPENED = { span: null, indexedUntil: null, topics: [] };

function answering(worker: ScriptedWorker, message: ToWorker): void {
  if (message.type !== "request") return;
  if (message.request.kind === "open") worker.say({ type: "answer", id: message.id, answer: OPENED });
  else worker.say({ type: "answer", id: message.id, answer: { fields: [] } });
}

function reader(acts: ((worker: ScriptedWorker, message: ToWorker) => void)[], more: { timeoutMs?: number; onRead?: (bytes: number) => void } = {}) {
  const workers: ScriptedWorker[] = [];
  const made = new RecordingReader({
    file: { format: "mcap", sizeBytes: 10 },
    address: () => Promise.resolve({ url: "http://store.test/x", expiresAtMs: 1 }),
    start: () => {
      const worker = new ScriptedWorker(acts[workers.length] ?? answering);
      workers.push(worker);
      return worker;
    },
    ...more,
  });
  return { made, workers };
}

describe("RecordingReader", () => {
  it("opens once, then asks", async () => {
    const { made, workers } = reader([]);
    await Promise.all([made.request("fields", { topic: "/a" }), made.request("fields", { topic: "/b" })]);
    const kinds = workers.flatMap(({ received }) => received).map((message) => (message.type === "request" ? message.request.kind : message.type));
    expect(kinds).toEqual(["open", "fields", "fields"]);
  });

  it("tells that a worker died, and starts another for the next question", async () => {
    const dying = (worker: ScriptedWorker, message: ToWorker): void => {
      if (message.type === "request" && message.request.kind === "fields") worker.onerror?.(new ErrorEvent("error", { cancelable: true }));
      else answering(worker, message);
    };
    const { made, workers } = reader([dying]);
    await expect(made.request("fields", { topic: "/a" })).rejects.toMatchObject({ code: "worker_ended" });
    expect(workers[0]?.isEnded).toBe(true);
    expect(await made.request("fields", { topic: "/a" })).toEqual({ fields: [] });
    expect(workers).toHaveLength(2);
  });

  it("ends a worker that owes an answer and says nothing", async () => {
    vi.useFakeTimers();
    const { made, workers } = reader([() => undefined], { timeoutMs: 1000 });
    const expectation = expect(made.open()).rejects.toMatchObject({ code: "worker_silent" });
    await vi.advanceTimersByTimeAsync(1001);
    await expectation;
    expect(workers[0]?.isEnded).toBe(true);
    expect(await made.open()).toEqual(OPENED);
    vi.useRealTimers();
  });

  it("gives the worker another address when it asks, or says why not", async () => {
    const { made, workers } = reader([]);
    await made.open();
    workers[0]?.say({ type: "renew", id: 0 });
    await vi.waitFor(() => expect(workers[0]?.received.at(-1)).toMatchObject({ type: "address", address: { url: "http://store.test/x" } }));
  });

  it("passes cancelling on, and counts what was read over workers", async () => {
    const read: number[] = [];
    const busy = (worker: ScriptedWorker, message: ToWorker): void => {
      if (message.type === "cancel") worker.say({ type: "failure", id: message.id, code: "cancelled", detail: "" });
      else if (message.type === "request" && message.request.kind === "open") answering(worker, message);
    };
    const { made, workers } = reader([busy], { onRead: (bytes) => read.push(bytes) });
    await made.open();
    workers[0]?.say({ type: "read", bytes: 100 });
    const ending = new AbortController();
    const fields = made.request("fields", { topic: "/a" }, { signal: ending.signal });
    await vi.waitFor(() => expect(workers[0]?.received).toHaveLength(2));
    ending.abort();
    await expect(fields).rejects.toMatchObject({ code: "cancelled" });
    workers[0]?.onerror?.(new ErrorEvent("error"));
    await made.open();
    workers[1]?.say({ type: "read", bytes: 5 });
    await vi.waitFor(() => expect(read).toEqual([100, 105]));
  });
});
