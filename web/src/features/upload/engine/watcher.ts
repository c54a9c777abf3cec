// Hears what an upload does, file by file. Must return at once.

import type { Failure, FileState, Trouble } from "./types";

export interface Watcher {
  state(path: string, state: FileState): void;
  /** So many more bytes were read for the checksums of the whole, before anything is sent; 0 begins anew. */
  read(path: string, sizeBytes: number): void;
  /** So many more bytes are at the store; negative when they must be sent again. */
  moved(path: string, sizeBytes: number): void;
  /** So many bytes need not be sent: the other side has them. */
  held(path: string, sizeBytes: number): void;
  /** A file is done, well or not. */
  ended(path: string, state: FileState, fileId: string | null, failure: Failure | null): void;
  /** Nothing that was sent of a file counts any more. */
  reset(path: string): void;
  /** Whom it waits for, or that this is over. */
  trouble(trouble: Trouble, isOver: boolean): void;
}
