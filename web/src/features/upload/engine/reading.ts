// Reads chosen files in slices, detects changes, walks dropped folders, and resumes from the journal.
import { MIN_PART_BYTES, type Found, type PlannedFile, type UploadFile } from "./types";
import type { Hashing, WholeSums } from "./checksums";
import type { JournalFile } from "./journal";

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
    // Browsers throw NotReadableError for a modified file, and NotFoundError for a missing one.
    const why = error instanceof Error ? error.name : "";
    if (why === "NotReadableError" || why === "NotFoundError") throw new FileFailure("file_changed", why);
    throw new FileFailure("file_unreadable", why);
  }
  if (bytes.byteLength !== until - offset) throw new FileFailure("file_changed", "");
  return new Uint8Array(bytes);
}

export class Candidate {
  sums: WholeSums | null = null;
  private uploadId: string | null;
  /** The checksum of a file that was there before the reload, where it still is the same file. */
  private doneSha256: string | null = null;

  constructor(
    readonly planned: PlannedFile,
    private readonly remembered: JournalFile | null,
  ) {
    this.uploadId = remembered?.uploadId ?? null;
    const isSame =
      remembered?.sizeBytes === planned.identity.sizeBytes && remembered.modifiedMs === planned.identity.modifiedMs;
    if (isSame && remembered.state === "done") this.doneSha256 = remembered.sha256;
  }

  get sha256(): string | null {
    return this.sums?.sha256 ?? this.doneSha256;
  }

  /** Whether it is read before it is announced, so that it is decided in one answer. */
  get isSmall(): boolean {
    return this.doneSha256 === null && this.planned.identity.sizeBytes <= MIN_PART_BYTES;
  }

  /** Forget and return an earlier upload of this file with a different size, which cannot resume. */
  dropOtherSize(): string | null {
    if (this.remembered === null || this.remembered.sizeBytes === this.planned.identity.sizeBytes) return null;
    const lost = this.uploadId;
    this.uploadId = null;
    return lost;
  }

  /** Forget the upload begun earlier; return whether there was one. */
  forgetUpload(): boolean {
    const was = this.uploadId !== null;
    this.uploadId = null;
    return was;
  }

  /** Return the announcement to the server. */
  announcement(): UploadFile {
    const { path, identity } = this.planned;
    return { path, size_bytes: identity.sizeBytes, sha256: this.sha256, upload_id: this.uploadId };
  }

  /** Read all of the file for its checksums; `read` is called for each slice and can delay or abort. @throws FileFailure */
  async hashWhole(hashing: Hashing, read: (sizeBytes: number) => Promise<void>): Promise<void> {
    hashing.beginWhole();
    for await (const bytes of slices(this.planned, 0, this.planned.identity.sizeBytes)) {
      await read(bytes.length);
      hashing.addToWhole(bytes);
    }
    this.sums = hashing.endWhole();
    await checkUnchanged(this.planned);
  }
}

/** Return the files that one chose; of a chosen folder with their paths from that folder on. */
export function chosen(files: Iterable<File>): Found[] {
  return [...files].map((file) => ({ path: file.webkitRelativePath === "" ? file.name : file.webkitRelativePath, file }));
}

/** Return the entries of a drop. Must be called while the drop is being handled: afterwards the browser forgets it. */
export function entriesOf(transfer: DataTransfer): FileSystemEntry[] {
  return [...transfer.items].flatMap((item) => {
    const entry = item.kind === "file" ? item.webkitGetAsEntry() : null;
    return entry === null ? [] : [entry];
  });
}

/** What walking through dropped folders found. */
export interface Walked {
  readonly droppedFiles: Found[];
  /** Paths that the browser could not read. */
  readonly unreadable: string[];
}

/** Return all files below dropped entries; `seen` receives the count so far. */
export async function walk(entries: readonly FileSystemEntry[], seen: (count: number) => void): Promise<Walked> {
  const walked: Walked = { droppedFiles: [], unreadable: [] };
  const waiting = [...entries];
  for (let entry = waiting.pop(); entry !== undefined; entry = waiting.pop()) {
    const path = entry.fullPath.replace(/^\//, "");
    try {
      if (isFolder(entry)) {
        waiting.push(...(await contentsOf(entry)));
      } else {
        const fresh = asFile(entry as FileSystemFileEntry);
        walked.droppedFiles.push({ path, file: await fresh(), again: fresh });
        seen(walked.droppedFiles.length);
      }
    } catch {
      walked.unreadable.push(path);
    }
  }
  return walked;
}

function isFolder(entry: FileSystemEntry): entry is FileSystemDirectoryEntry {
  return entry.isDirectory;
}

function asFile(entry: FileSystemFileEntry): () => Promise<File> {
  return () => new Promise((resolve, reject) => entry.file(resolve, reject));
}

async function contentsOf(folder: FileSystemDirectoryEntry): Promise<FileSystemEntry[]> {
  const reader = folder.createReader();
  const all: FileSystemEntry[] = [];
  for (;;) {
    // A hundred at a time, until there are none.
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (some.length === 0) return all;
    all.push(...some);
  }
}
