// The reading worker of one file, bound to the lifetime of a component.
import { onScopeDispose, ref, type Ref } from "vue";
import { api, call } from "@/api/client";
import { toProblem } from "@/api/problem";
import { repeated } from "@/api/queries";
import type { File } from "@/api/types";
import { ReadFailure } from "@/recordings/failures";
import type { ReadableFormat } from "@/recordings/protocol";
import type { Address } from "@/recordings/ranges";
import { RecordingReader, type WorkerLike } from "@/recordings/reader";

export interface FileReader {
  readonly reader: RecordingReader;
  /** Bytes that were fetched of the file. */
  readonly bytesRead: Ref<number>;
}

/** Requests a temporary URL of a file; the audit log records the purpose. */
export async function addressOf(fileId: string, purpose: "download" | "preview"): Promise<Address> {
  const { items } = await repeated(() => call(api.POST("/api/v1/files/download", { body: { file_ids: [fileId], purpose } })));
  const [link] = items;
  if (link === undefined) throw new ReadFailure("link_refused");
  return { url: link.url, expiresAtMs: Date.parse(link.expires_at) };
}

/** Workers that loaded their program before somebody needs them. */
const prepared: Worker[] = [];

/** Starts workers ahead of the first readers: to load their program takes as long as to learn what there is to read. */
export function prepareReaders(count: number): void {
  while (prepared.length < count) {
    const worker = createWorker();
    worker.onerror = () => {
      worker.terminate();
      const place = prepared.indexOf(worker);
      if (place >= 0) prepared.splice(place, 1); // the reader that starts another one reports it
    };
    prepared.push(worker);
  }
}

function createWorker(): Worker {
  return new Worker(new URL("@/recordings/worker.ts", import.meta.url), { type: "module", name: "recording" });
}

function start(): WorkerLike {
  return prepared.pop() ?? createWorker();
}

/** What the reader must know of a file. */
export interface ReadableFile {
  readonly id: string;
  readonly size_bytes: number;
  readonly format: ReadableFormat;
}

export interface ReaderSettings {
  readonly onRead: (bytes: number) => void;
  /** Decompressed chunks that stay in memory. */
  readonly cacheBytes?: number;
  /** What for, in the audit log. */
  readonly purpose?: "download" | "preview";
}

/** Returns a reader of a file. Its owner closes it. */
export function openReader(file: ReadableFile, { onRead, cacheBytes, purpose = "preview" }: ReaderSettings): RecordingReader {
  return new RecordingReader({
    file: { format: file.format, sizeBytes: file.size_bytes, ...(cacheBytes !== undefined && { cacheBytes }) },
    address: async () => {
      try {
        return await addressOf(file.id, purpose);
      } catch (thrown) {
        throw thrown instanceof ReadFailure ? thrown : new ReadFailure("link_refused", toProblem(thrown).code);
      }
    },
    start,
    onRead,
  });
}

/** Returns a reader of a file of a format that can be read here, which is closed with the component. */
export function useReader(file: File, format: ReadableFormat, purpose: "download" | "preview" = "preview"): FileReader {
  const bytesRead = ref(0);
  const settings = { purpose, onRead: (bytes: number) => (bytesRead.value = bytes) };
  const reader = openReader({ id: file.id, size_bytes: file.size_bytes, format }, settings);
  onScopeDispose(() => reader.close());
  return { reader, bytesRead };
}

/** Returns a function that does `act` with what it was last given, as soon as the one before is done. */
export function latest<Item>(act: (item: Item) => Promise<void>): (item: Item) => void {
  let waiting: { readonly item: Item } | null = null;
  let isBusy = false;

  async function run(): Promise<void> {
    isBusy = true;
    try {
      for (let next = waiting; next !== null; next = waiting) {
        waiting = null;
        await act(next.item);
      }
    } finally {
      isBusy = false;
    }
  }

  return (item) => {
    waiting = { item };
    if (!isBusy) void run();
  };
}
