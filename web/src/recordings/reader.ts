/** The page's client of the reading worker. It starts another worker after one crashed or stopped responding. */

import { ReadFailure, type FailureCode } from "./failures";
import { WORKER_TIMEOUT_MS } from "./limits";
import type { MessageRequest, MessagesRequest, ProductName, ReadMessage } from "./products/products";
import type { Answer, DrawnCurves, FoundMessage, FromWorker, ReadMessages, RecordingFile, Request, RequestKind, Requests, SliceProgress, ToWorker } from "./protocol";
import type { Address } from "./ranges";

/** What of a Worker is used. */
export interface WorkerLike {
  postMessage(message: ToWorker): void;
  terminate(): void;
  onmessage: ((event: MessageEvent<FromWorker>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
  onmessageerror: ((event: MessageEvent) => void) | null;
}

export interface ReaderOptions {
  file: RecordingFile;
  /** Requests a URL from the server; rejects with a ReadFailure. */
  address: () => Promise<Address>;
  start: () => WorkerLike;
  onRead?: (bytes: number) => void;
  timeoutMs?: number;
}

interface Waiting {
  resolve: (answer: never) => void;
  reject: (failure: ReadFailure) => void;
  onCurves: ((curves: DrawnCurves) => void) | undefined;
  onSliced: ((progress: SliceProgress) => void) | undefined;
}

export interface RequestOptions {
  signal?: AbortSignal;
  /** Requests that wait are served by ascending priority; a long one pauses for those below its own. */
  priority?: number;
  onCurves?: (curves: DrawnCurves) => void;
  onSliced?: (progress: SliceProgress) => void;
}

export type MessageAnswer<P extends ProductName> = Omit<FoundMessage, "message"> & { message: ReadMessage<P> | null };
export type MessagesAnswer<P extends ProductName> = Omit<ReadMessages, "messages"> & { messages: ReadMessage<P>[] };

export class RecordingReader {
  private worker: WorkerLike | null = null;
  /** Requested while the worker starts, for its first request for one. */
  private firstAddress: Promise<Address> | null = null;
  private opened: Promise<Answer<"open">> | null = null;
  private readonly waiting = new Map<number, Waiting>();
  private lastId = 0;
  private watch: ReturnType<typeof setTimeout> | undefined;
  private readBefore = 0;
  private readNow = 0;

  constructor(private readonly options: ReaderOptions) {}

  /** Open the recording, once per worker. */
  open(): Promise<Answer<"open">> {
    this.opened ??= this.send<"open">({ kind: "open", ...this.options.file }, {});
    this.opened.catch(() => (this.opened = null));
    return this.opened;
  }

  /** Send a request to the worker, after the recording is open. */
  async request<K extends Exclude<RequestKind, "open">>(kind: K, request: Requests[K]["request"], options: RequestOptions = {}): Promise<Answer<K>> {
    await this.open();
    return this.send<K>({ kind, ...request } as unknown as Request, options);
  }

  /** Find a message; its product has the type of the requested one. */
  message<P extends ProductName>(request: MessageRequest<P>, options?: RequestOptions): Promise<MessageAnswer<P>> {
    return this.request("message", request, options) as Promise<MessageAnswer<P>>;
  }

  /** Read the messages of a span; see `message`. */
  messages<P extends ProductName>(request: MessagesRequest<P>, options?: RequestOptions): Promise<MessagesAnswer<P>> {
    return this.request("messages", request, options) as Promise<MessagesAnswer<P>>;
  }

  /** End the worker; pending requests are cancelled. */
  close(): void {
    this.end("cancelled");
  }

  private send<K extends RequestKind>(request: Request, { signal, priority = 0, onCurves, onSliced }: RequestOptions): Promise<Answer<K>> {
    if (signal?.aborted === true) return Promise.reject(new ReadFailure("cancelled"));
    const worker = this.started();
    const id = ++this.lastId;
    const cancel = (): void => worker.postMessage({ type: "cancel", id });
    signal?.addEventListener("abort", cancel, { once: true });
    const answer = new Promise<Answer<K>>((resolve, reject) => this.waiting.set(id, { resolve, reject, onCurves, onSliced }));
    worker.postMessage({ type: "request", id, priority, request });
    this.watchOver();
    return answer.finally(() => signal?.removeEventListener("abort", cancel));
  }

  private started(): WorkerLike {
    if (this.worker !== null) return this.worker;
    const worker = this.options.start();
    this.firstAddress = this.options.address();
    this.firstAddress.catch(() => undefined); // the worker hears of it once it asks
    worker.onmessage = ({ data }) => this.receive(worker, data);
    worker.onerror = (event) => {
      event.preventDefault(); // shown as a ReadFailure, not in the console
      this.end("worker_ended");
    };
    worker.onmessageerror = () => this.end("worker_ended");
    this.worker = worker;
    return worker;
  }

  private receive(worker: WorkerLike, message: FromWorker): void {
    this.watchOver();
    if (message.type === "renew") void this.renew(worker);
    else if (message.type === "read") this.noteRead(message.bytes);
    else if (message.type === "progress") this.waiting.get(message.id)?.onCurves?.(message.curves);
    else if (message.type === "sliced") this.waiting.get(message.id)?.onSliced?.(message.progress);
    else {
      const waiting = this.waiting.get(message.id);
      this.waiting.delete(message.id);
      if (message.type === "answer") waiting?.resolve(message.answer as never);
      else waiting?.reject(new ReadFailure(message.code, message.detail));
      this.watchOver();
    }
  }

  private async renew(worker: WorkerLike): Promise<void> {
    const address = this.firstAddress ?? this.options.address();
    this.firstAddress = null;
    try {
      worker.postMessage({ type: "address", id: 0, address: await address, reason: "link_refused" });
    } catch (thrown) {
      const reason: FailureCode = thrown instanceof ReadFailure ? thrown.code : "link_refused";
      worker.postMessage({ type: "address", id: 0, address: null, reason });
    }
  }

  private noteRead(bytes: number): void {
    this.readNow = bytes;
    this.options.onRead?.(this.readBefore + bytes);
  }

  /** Ends a worker that does not respond: a malicious file could keep it busy forever. */
  private watchOver(): void {
    clearTimeout(this.watch);
    if (this.waiting.size === 0) return;
    this.watch = setTimeout(() => this.end("worker_silent"), this.options.timeoutMs ?? WORKER_TIMEOUT_MS);
  }

  private end(code: FailureCode): void {
    clearTimeout(this.watch);
    this.worker?.terminate();
    this.worker = null;
    this.opened = null;
    this.readBefore += this.readNow;
    this.readNow = 0;
    const waiting = [...this.waiting.values()];
    this.waiting.clear();
    for (const { reject } of waiting) reject(new ReadFailure(code));
  }
}
