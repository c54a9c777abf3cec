/** Makes a slice in the worker: into a file that the person chose, or into memory. */

import { ReadFailure } from "../failures";
import type { Recording } from "../formats/recording";
import { MAX_SLICE_IN_MEMORY } from "../limits";
import type { MadeSlice, SliceOrder } from "../protocol";
import type { Observer } from "../session";
import { writeSlice } from "./slice";

interface Target {
  write: (bytes: Uint8Array<ArrayBuffer>) => Promise<void>;
  /** Keep what was written; returns it where it is in memory. */
  keep: () => Promise<Blob | null>;
  discard: () => Promise<void>;
}

/** @throws ReadFailure not_saved, and what `writeSlice` throws; then nothing of the slice is left. */
export async function makeSlice(recording: Recording, { handle, ...request }: SliceOrder, { signal, onSliced }: Observer): Promise<MadeSlice> {
  const target = handle === null ? inMemory() : await inFile(handle);
  try {
    const { zstdCompression } = await import("./zstd"); // a large module, which previews do without
    const result = await writeSlice(recording, request, {
      compression: await zstdCompression(),
      write: (bytes) => target.write(bytes as Uint8Array<ArrayBuffer>),
      onProgress: (share, bytes) => onSliced({ share, bytes }),
      signal,
    });
    return { ...result, blob: await target.keep() };
  } catch (thrown) {
    await target.discard();
    throw thrown;
  }
}

function inMemory(): Target {
  let parts: Blob[] = [];
  let size = 0;
  return {
    write: (bytes) => {
      size += bytes.length;
      if (size > MAX_SLICE_IN_MEMORY) return Promise.reject(new ReadFailure("not_sliceable", "the selection does not fit in memory"));
      parts.push(new Blob([bytes])); // which the browser may move to the disk
      return Promise.resolve();
    },
    keep: () => Promise.resolve(new Blob(parts, { type: "application/octet-stream" })),
    discard: () => {
      parts = [];
      return Promise.resolve();
    },
  };
}

/** The content of the file appears when it is complete. */
async function inFile(handle: FileSystemFileHandle): Promise<Target> {
  const writable = await saving(handle.createWritable());
  return {
    write: (bytes) => saving(writable.write(bytes)),
    keep: async () => {
      await saving(writable.close());
      return null;
    },
    discard: () => writable.abort().catch(() => undefined),
  };
}

async function saving<Result>(step: Promise<Result>): Promise<Result> {
  try {
    return await step;
  } catch (thrown) {
    throw new ReadFailure("not_saved", thrown instanceof Error ? thrown.message : "");
  }
}
