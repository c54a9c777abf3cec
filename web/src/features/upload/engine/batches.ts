// Which files are announced together.

import type { PlannedFile } from "./types";

const FIRST_BATCH_FILES = 16;
const BATCH_FILES = 100;
const BATCH_BYTES = 128 * 1024 * 1024;

/**
 * Yield files to announce together, in order: a few large ones are not hashed ahead, many small ones are. The first
 * batch is small, so that sending begins at once.
 */
export function* batches(files: Iterable<PlannedFile>): Generator<PlannedFile[]> {
  let batch: PlannedFile[] = [];
  let sizeBytes = 0;
  let atMost = FIRST_BATCH_FILES;
  for (const file of files) {
    if (batch.length > 0 && (batch.length === atMost || sizeBytes + file.identity.sizeBytes > BATCH_BYTES)) {
      yield batch;
      [batch, sizeBytes, atMost] = [[], 0, BATCH_FILES];
    }
    batch.push(file);
    sizeBytes += file.identity.sizeBytes;
  }
  if (batch.length > 0) yield batch;
}
