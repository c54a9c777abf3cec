// Reading a chosen file in slices, and finding out whether it is still the file that was chosen.

import type { PlannedFile } from "./types";

const SLICE_BYTES = 2 * 1024 * 1024;

/** The file is not the one that was chosen, or its disk does not give its bytes. */
export class FileFailure extends Error {
  override readonly name = "FileFailure";

  constructor(
    readonly kind: "file_changed" | "file_unreadable",
    readonly detail: string,
  ) {
    super(kind);
  }
}

/**
 * Yield the bytes from `offset`, in slices; while one is used the next is being read, so two are in memory.
 *
 * @throws FileFailure
 */
export async function* slices(planned: PlannedFile, offset: number, sizeBytes: number): AsyncGenerator<Uint8Array> {
  const end = offset + sizeBytes;
  let next = offset < end ? readSlice(planned, offset, end) : null;
  while (next !== null) {
    const bytes = await next;
    offset += bytes.length;
    next = offset < end ? readSlice(planned, offset, end) : null;
    next?.catch(() => undefined); // heard when it is awaited, or not at all where the reader stops
    yield bytes;
  }
}

/**
 * Make sure that the file can still be read as it was chosen: a browser refuses once it was written to.
 *
 * @throws FileFailure
 */
export async function checkUnchanged(planned: PlannedFile): Promise<void> {
  const { sizeBytes, modifiedMs } = planned.identity;
  if (planned.file.size !== sizeBytes || planned.file.lastModified !== modifiedMs) {
    throw new FileFailure("file_changed", "");
  }
  if (sizeBytes > 0) await readSlice(planned, sizeBytes - 1, sizeBytes);
}

async function readSlice(planned: PlannedFile, offset: number, end: number): Promise<Uint8Array> {
  const until = Math.min(offset + SLICE_BYTES, end);
  let bytes: ArrayBuffer;
  try {
    bytes = await planned.file.slice(offset, until).arrayBuffer();
  } catch (error) {
    // Browsers say NotReadableError for a file that was written to, and NotFoundError for one that is gone.
    const why = error instanceof Error ? error.name : "";
    if (why === "NotReadableError" || why === "NotFoundError") throw new FileFailure("file_changed", why);
    throw new FileFailure("file_unreadable", why);
  }
  if (bytes.byteLength !== until - offset) throw new FileFailure("file_changed", "");
  return new Uint8Array(bytes);
}
