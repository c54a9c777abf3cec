// From what a browser hands over when something is dropped or chosen, to files with their paths. Empty folders are no
// files; links are followed by the browser itself, or not at all.

import type { Found } from "./types";

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
  readonly found: Found[];
  /** Paths that the browser could not read. */
  readonly unreadable: string[];
}

/** Return all files below dropped entries; `seen` hears how many there are so far. */
export async function walk(entries: readonly FileSystemEntry[], seen: (count: number) => void): Promise<Walked> {
  const walked: Walked = { found: [], unreadable: [] };
  const waiting = [...entries];
  for (let entry = waiting.pop(); entry !== undefined; entry = waiting.pop()) {
    const path = entry.fullPath.replace(/^\//, "");
    try {
      if (isFolder(entry)) {
        waiting.push(...(await contentsOf(entry)));
      } else {
        const fresh = asFile(entry as FileSystemFileEntry);
        walked.found.push({ path, file: await fresh(), again: fresh });
        seen(walked.found.length);
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
