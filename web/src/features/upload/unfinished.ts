// Unfinished uploads of earlier visits from this browser's journal, and how newly chosen files match them.
import { shallowRef, type Ref } from "vue";
import { lockName, openJournal, type Journal, type JournalFile, type JournalHead } from "./engine/journal";
import { partSizeBytes, type PlannedFile } from "./engine/types";

/** An upload that did not complete. */
export interface Unfinished {
  readonly head: JournalHead;
  readonly left: readonly JournalFile[];
  readonly doneCount: number;
  readonly leftBytes: number;
  /** Of these, about how many are at the store already. */
  readonly storedBytes: number;
  /** Another tab of this browser works on it. */
  readonly isElsewhere: boolean;
}

/** How newly selected files match an unfinished upload. */
export interface Fit {
  /** As they were, or not begun then. */
  readonly same: number;
  /** Files with a different size or time than before: differing parts are sent again. */
  readonly changed: readonly string[];
  /** Unfinished files that are not in the selection. */
  readonly missing: readonly string[];
}

/** Return the remaining files of an upload. */
async function summarised(journal: Journal, head: JournalHead, isElsewhere: boolean): Promise<Unfinished> {
  const files = await journal.files(head.id);
  const left = files.filter((file) => file.state !== "done");
  const leftBytes = left.reduce((sum, file) => sum + file.sizeBytes, 0);
  let storedBytes = 0;
  for (const { uploadId, sizeBytes } of left) {
    const parts = uploadId === null ? 0 : (await journal.parts(uploadId)).size;
    storedBytes += Math.min(sizeBytes, parts * partSizeBytes(sizeBytes));
  }
  return { head, left, doneCount: files.length - left.length, leftBytes, storedBytes, isElsewhere };
}

/** Compare newly selected files with the remaining files. */
export function fitOf(unfinished: Unfinished, files: readonly PlannedFile[]): Fit {
  const chosen = new Map(files.map((file) => [file.path, file.identity]));
  const changed: string[] = [];
  const missing: string[] = [];
  for (const { path, sizeBytes, modifiedMs } of unfinished.left) {
    const now = chosen.get(path);
    if (now === undefined) missing.push(path);
    else if (now.sizeBytes !== sizeBytes || now.modifiedMs !== modifiedMs) changed.push(path);
  }
  return { same: unfinished.left.length - changed.length - missing.length, changed, missing };
}

/** Return whether any unfinished file is among those chosen. */
export function fits(fit: Fit): boolean {
  return fit.same + fit.changed.length > 0;
}

let opening: Promise<Journal | null> | null = null;

/** Return the journal; null where this browser keeps nothing for the page. */
function journal(): Promise<Journal | null> {
  opening ??= openJournal().catch(() => null);
  return opening;
}

/** Return the locks that tabs of this browser hold; none where the page came unsafely, and tabs have no locks. */
async function activeLocks(): Promise<Set<string | undefined>> {
  if (!("locks" in navigator)) return new Set();
  const locks = await navigator.locks.query();
  return new Set(locks.held?.map(({ name }) => name));
}

export interface UnfinishedUploads {
  readonly all: Ref<readonly Unfinished[]>;
  /** False if a reload loses uploads in progress. */
  readonly isPersistent: Ref<boolean>;
  load(personId: string): Promise<void>;
  discard(unfinished: Unfinished): Promise<void>;
}

export function useUnfinished(): UnfinishedUploads {
  const all = shallowRef<readonly Unfinished[]>([]);
  const isPersistent = shallowRef(true);

  async function load(personId: string): Promise<void> {
    const opened = await journal();
    isPersistent.value = opened !== null;
    if (opened === null) return;
    const uploads: Unfinished[] = [];
    const locks = await activeLocks();
    for (const head of await opened.heads(personId)) uploads.push(await summarised(opened, head, locks.has(lockName(head.id))));
    all.value = uploads.filter(({ left }) => left.length > 0);
  }

  async function discard({ head, left }: Unfinished): Promise<void> {
    const opened = await journal();
    await opened?.drop(head.id);
    all.value = all.value.filter((item) => item.head.id !== head.id);
    const { httpApi } = await import("./engine/api");
    const api = httpApi(globalThis.location.origin);
    // This frees the names at once; without it the uploads expire.
    for (const { uploadId } of left) if (uploadId !== null) await api.abort(uploadId);
  }

  return { all, isPersistent, load, discard };
}
