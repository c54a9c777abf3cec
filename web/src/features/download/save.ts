// Writes stored files into a folder, or into one zip. Reads byte ranges of a few megabytes; a file gets its final name
// only after its size, and its SHA-256 if known, were verified.
import { downloadZip } from "client-zip";
import { createSHA256 } from "hash-wasm";

export interface Target {
  readonly fileId: string;
  /** Folders and name, none of them empty. */
  readonly path: readonly string[];
  readonly sizeBytes: number;
}

export interface Link {
  readonly url: string;
  readonly sha256: string | null;
}

export interface Source {
  /** Returns an address of a file's bytes, good for some minutes. */
  readonly linkOf: (target: Target, signal: AbortSignal) => Promise<Link>;
  readonly fetch: typeof fetch;
}

export interface Failed {
  readonly path: string;
  readonly reason: string;
}

export interface Saved {
  readonly written: number;
  /** Files that were already complete. */
  readonly skipped: number;
  readonly failures: readonly Failed[];
}

export interface Progress {
  readonly signal: AbortSignal;
  /** Called with the number of bytes that came, or were there. */
  readonly onBytes: (bytes: number) => void;
}

/** The message of a failed file. */
export const reasons = {
  sameName: "Another file of this download has the same name on this computer. Use the command instead.",
  inTheWay: "A different file of this name is already there. Move it away, or choose another folder.",
  wrongBytes: "The bytes that came do not match the checksum. Try again.",
  cut: "The store sent fewer bytes than the file has. Try again.",
  refused: (status: number) => `The store answered with ${status}. Try again.`,
} as const;

const PART_BYTES = 8 * 2 ** 20;
const TRIES = 4;
const AT_ONCE = 3;
/** Beyond this a zip is not made: the browser would have to hold all of it. */
export const MAX_ZIP_BYTES = 1_000_000_000;

class FileFailed extends Error {}

/** Returns a path as a file system takes it, on any computer. */
export function safePath(path: string): string[] {
  return path
    .split("/")
    .filter((part) => part !== "" && part !== "." && part !== "..")
    // eslint-disable-next-line no-control-regex -- these are the characters that Windows refuses
    .map((part) => part.replaceAll(/[<>:"\\|?*\u0000-\u001f]/g, "_").replace(/[. ]+$/, (end) => "_".repeat(end.length)));
}

/** Yields the bytes of a file in parts; a failed part is requested again with a new URL. */
async function* partsOf(target: Target, source: Source, { signal, onBytes }: Progress): AsyncGenerator<Uint8Array<ArrayBuffer>> {
  const hash = await createSHA256();
  let link = await source.linkOf(target, signal);
  for (let from = 0; from < target.sizeBytes; ) {
    const until = Math.min(from + PART_BYTES, target.sizeBytes);
    let part: Uint8Array<ArrayBuffer> | null = null;
    for (let tries = 1; part === null; tries += 1) {
      try {
        part = await fetchPart(link.url, from, until, source, signal);
      } catch (thrown) {
        if (signal.aborted || tries === TRIES) throw thrown;
        link = await source.linkOf(target, signal);
      }
    }
    hash.update(part);
    onBytes(part.length);
    yield part;
    from = until;
  }
  if (link.sha256 !== null && hash.digest("hex") !== link.sha256) throw new FileFailed(reasons.wrongBytes);
}

async function fetchPart(url: string, from: number, until: number, source: Source, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>> {
  const answer = await source.fetch(url, { headers: { Range: `bytes=${from}-${until - 1}` }, signal });
  const isWhole = answer.status === 200 && from === 0;
  if (answer.status !== 206 && !isWhole) throw new FileFailed(reasons.refused(answer.status));
  const part = new Uint8Array(await answer.arrayBuffer());
  if (part.length !== until - from) throw new FileFailed(reasons.cut);
  return part;
}

function reasonOf(thrown: unknown): string {
  return thrown instanceof Error ? thrown.message : String(thrown);
}

function isMissing(thrown: unknown): boolean {
  return thrown instanceof DOMException && thrown.name === "NotFoundError";
}

/** Returns whether a existing file is the expected one; other files are never replaced. */
async function isDownloaded(existing: File, target: Target, sha256: string | null): Promise<boolean> {
  if (existing.size !== target.sizeBytes) {
    if (existing.size === 0) return false; // what a download that was broken off leaves
    throw new FileFailed(reasons.inTheWay);
  }
  if (sha256 === null) return true;
  const hash = await createSHA256();
  for (let from = 0; from < existing.size; from += PART_BYTES) {
    hash.update(new Uint8Array(await existing.slice(from, from + PART_BYTES).arrayBuffer()));
  }
  if (hash.digest("hex") !== sha256) throw new FileFailed(reasons.inTheWay);
  return true;
}

async function saveFile(root: FileSystemDirectoryHandle, target: Target, source: Source, progress: Progress): Promise<"written" | "skipped"> {
  const name = target.path.at(-1) ?? "file";
  let folder = root;
  for (const part of target.path.slice(0, -1)) folder = await folder.getDirectoryHandle(part, { create: true });
  let isNew = false;
  try {
    const existing = await (await folder.getFileHandle(name)).getFile();
    const { sha256 } = existing.size === target.sizeBytes ? await source.linkOf(target, progress.signal) : { sha256: null };
    if (await isDownloaded(existing, target, sha256)) {
      progress.onBytes(target.sizeBytes);
      return "skipped";
    }
  } catch (thrown) {
    if (!isMissing(thrown)) throw thrown;
    isNew = true;
  }
  const handle = await folder.getFileHandle(name, { create: true });
  const writable = await handle.createWritable(); // beside the file: its name shows nothing until it is closed
  try {
    for await (const part of partsOf(target, source, progress)) await writable.write(part);
    await writable.close();
  } catch (thrown) {
    await writable.abort().catch(() => undefined);
    if (isNew) await folder.removeEntry(name).catch(() => undefined);
    throw thrown;
  }
  return "written";
}

/** Divides targets into those whose path is theirs alone and those that would overwrite an earlier one. */
function placed(targets: readonly Target[], keyOf: (path: string) => string): { readonly first: readonly Target[]; readonly clashing: readonly Failed[] } {
  const taken = new Set<string>();
  const [first, clashing]: [Target[], Failed[]] = [[], []];
  for (const target of targets) {
    const path = target.path.join("/");
    if (taken.has(keyOf(path))) clashing.push({ path, reason: reasons.sameName });
    else first.push(target);
    taken.add(keyOf(path));
  }
  return { first, clashing };
}

function isStopped({ signal }: Progress): boolean {
  return signal.aborted;
}

/** Writes files below a folder. Files that are there, whole, are not fetched again: the same again resumes. */
export async function saveToFolder(root: FileSystemDirectoryHandle, targets: readonly Target[], source: Source, progress: Progress): Promise<Saved> {
  const count = { written: 0, skipped: 0 };
  const { first, clashing } = placed(targets, (path) => path.normalize().toLowerCase()); // as Windows and macOS compare names
  const failures: Failed[] = [...clashing];
  const waiting = first.values();
  async function work(): Promise<void> {
    for (const target of waiting) {
      if (isStopped(progress)) return;
      try {
        count[await saveFile(root, target, source, progress)] += 1;
      } catch (thrown) {
        if (!isStopped(progress)) failures.push({ path: target.path.join("/"), reason: reasonOf(thrown) });
      }
    }
  }
  await Promise.all(Array.from({ length: AT_ONCE }, work));
  return { ...count, failures };
}

/** Returns files as one zip, uncompressed. One file that fails fails the zip, by name. */
export async function zipOf(targets: readonly Target[], source: Source, progress: Progress): Promise<Blob> {
  const [clash] = placed(targets, (path) => path).clashing;
  if (clash) throw new FileFailed(`${clash.path}: ${clash.reason}`);
  function* inputs() {
    for (const target of targets) {
      const parts = partsOf(target, source, progress);
      const input = new ReadableStream<Uint8Array>({
        async pull(controller) {
          try {
            const next = await parts.next();
            if (next.done === true) controller.close();
            else controller.enqueue(next.value);
          } catch (thrown) {
            controller.error(isStopped(progress) ? thrown : new FileFailed(`${target.path.join("/")}: ${reasonOf(thrown)}`));
          }
        },
      });
      yield { name: target.path.join("/"), size: target.sizeBytes, input };
    }
  }
  return downloadZip(inputs()).blob();
}
