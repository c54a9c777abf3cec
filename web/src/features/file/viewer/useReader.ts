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

function start(): WorkerLike {
  return new Worker(new URL("@/recordings/worker.ts", import.meta.url), { type: "module", name: "recording" });
}

/** Returns a reader of a file of a format that can be read here; the audit log records what for. */
export function useReader(file: File, format: ReadableFormat, purpose: "download" | "preview" = "preview"): FileReader {
  const bytesRead = ref(0);
  const reader = new RecordingReader({
    file: { format, sizeBytes: file.size_bytes },
    address: async () => {
      try {
        return await addressOf(file.id, purpose);
      } catch (thrown) {
        throw thrown instanceof ReadFailure ? thrown : new ReadFailure("link_refused", toProblem(thrown).code);
      }
    },
    start,
    onRead: (bytes) => (bytesRead.value = bytes),
  });
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
