// The journal of uploads in this browser (IndexedDB), so that they resume after a reload or a crash.
//
// It is only a hint: a part is skipped if its bytes, hashed again, still have the checksum in the journal and the store still
// has the etag. Entries belong to a person and a mission, so that other users of the browser do not see them.
import type { components } from "@/api/schema";
import type { MissionPlace } from "./types";

export type StoredPart = components["schemas"]["StoredPart"];

/** An unfinished upload into one mission. */
export interface JournalHead {
  /** `PERSON/MISSION`: one unfinished upload a mission. */
  readonly id: string;
  readonly personId: string;
  readonly mission: MissionPlace;
  readonly layout: "tree" | "contents";
  /** The folders or files that were chosen. */
  readonly roots: readonly string[];
  /** Milliseconds since 1970. */
  readonly beganMs: number;
}

export interface JournalFile {
  readonly id: string;
  readonly path: string;
  readonly sizeBytes: number;
  readonly modifiedMs: number;
  readonly state: "waiting" | "sending" | "done";
  readonly uploadId: string | null;
  /** Of a file that is done. */
  readonly sha256: string | null;
}

/** A part that the store has taken. */
export interface JournalPart {
  readonly uploadId: string;
  readonly number: number;
  readonly checksum: string;
  readonly etag: string;
}

export interface Journal {
  heads(personId: string): Promise<JournalHead[]>;
  files(id: string): Promise<JournalFile[]>;
  parts(uploadId: string): Promise<Map<number, JournalPart>>;
  /** Record an upload, or more files of one; recorded files stay unchanged. */
  begin(head: JournalHead, files: readonly JournalFile[]): Promise<void>;
  /** Record the states of files, and drop the parts of `forgotten` uploads. */
  note(files: readonly JournalFile[], forgotten?: readonly string[]): Promise<void>;
  record(part: JournalPart): Promise<void>;
  /** Drop an upload with all its files and parts. */
  drop(id: string): Promise<void>;
  /** Drop files that will not be uploaded. */
  remove(id: string, paths: readonly string[]): Promise<void>;
}

/** Return the name of the lock that a tab holds while it works on an upload. */
export function lockName(id: string): string {
  return `kleinkram-upload ${id}`;
}

export function journalId(personId: string, missionId: string): string {
  return `${personId}/${missionId}`;
}

const NAME = "kleinkram-uploads";
const VERSION = 1;
const [HEADS, FILES, PARTS] = ["heads", "files", "parts"] as const;

/** Open the journal. @throws DOMException where the browser keeps nothing for this page */
export async function openJournal(): Promise<Journal> {
  const opening = indexedDB.open(NAME, VERSION);
  opening.onupgradeneeded = () => {
    opening.result.createObjectStore(HEADS, { keyPath: "id" });
    opening.result.createObjectStore(FILES, { keyPath: ["id", "path"] });
    opening.result.createObjectStore(PARTS, { keyPath: ["uploadId", "number"] });
  };
  const database = await answered(opening);
  database.onversionchange = () => database.close();
  return new IndexedJournal(database);
}

class IndexedJournal implements Journal {
  constructor(private readonly database: IDBDatabase) {}

  async heads(personId: string): Promise<JournalHead[]> {
    const all = (await answered(this.reading(HEADS).getAll())) as JournalHead[];
    return all.filter((head) => head.personId === personId);
  }

  async files(id: string): Promise<JournalFile[]> {
    return (await answered(this.reading(FILES).getAll(below(id)))) as JournalFile[];
  }

  async parts(uploadId: string): Promise<Map<number, JournalPart>> {
    const all = (await answered(this.reading(PARTS).getAll(below(uploadId)))) as JournalPart[];
    return new Map(all.map((part) => [part.number, part]));
  }

  async begin(head: JournalHead, files: readonly JournalFile[]): Promise<void> {
    const known = new Set((await this.files(head.id)).map((file) => file.path));
    await this.write([HEADS, FILES], (stores) => {
      stores(HEADS).put(head);
      for (const file of files) if (!known.has(file.path)) stores(FILES).put(file);
    });
  }

  async note(files: readonly JournalFile[], forgotten: readonly string[] = []): Promise<void> {
    await this.write([FILES, PARTS], (stores) => {
      for (const file of files) stores(FILES).put(file);
      for (const uploadId of forgotten) stores(PARTS).delete(below(uploadId));
    });
  }

  async record(part: JournalPart): Promise<void> {
    await this.write([PARTS], (stores) => void stores(PARTS).put(part));
  }

  async remove(id: string, paths: readonly string[]): Promise<void> {
    await this.write([FILES], (stores) => {
      for (const path of paths) stores(FILES).delete([id, path]);
    });
  }

  async drop(id: string): Promise<void> {
    const uploads = (await this.files(id)).map((file) => file.uploadId);
    await this.write([HEADS, FILES, PARTS], (stores) => {
      stores(HEADS).delete(id);
      stores(FILES).delete(below(id));
      for (const uploadId of uploads) if (uploadId !== null) stores(PARTS).delete(below(uploadId));
    });
  }

  private reading(name: string): IDBObjectStore {
    return this.database.transaction(name).objectStore(name);
  }

  private async write(names: string[], change: (stores: (name: string) => IDBObjectStore) => void): Promise<void> {
    const transaction = this.database.transaction(names, "readwrite");
    change((name) => transaction.objectStore(name));
    await new Promise<void>((resolve, reject) => {
      transaction.oncomplete = () => resolve();
      transaction.onabort = () => reject(transaction.error ?? new Error("the browser dropped a change of its journal"));
    });
  }
}

/** All keys that begin with one value: in IndexedDB's order an array comes after every other value. */
function below(first: string): IDBKeyRange {
  return IDBKeyRange.bound([first], [first, []]);
}

function answered<T>(request: IDBRequest<T>): Promise<T> {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error ?? new Error("the browser does not open its journal"));
  });
}

export class MemoryJournal implements Journal {
  private readonly allHeads = new Map<string, JournalHead>();
  private readonly allFiles = new Map<string, Map<string, JournalFile>>();
  private readonly allParts = new Map<string, Map<number, JournalPart>>();

  heads(personId: string): Promise<JournalHead[]> {
    return Promise.resolve([...this.allHeads.values()].filter((head) => head.personId === personId));
  }

  files(id: string): Promise<JournalFile[]> {
    return Promise.resolve([...(this.allFiles.get(id)?.values() ?? [])]);
  }

  parts(uploadId: string): Promise<Map<number, JournalPart>> {
    return Promise.resolve(new Map(this.allParts.get(uploadId)));
  }

  begin(head: JournalHead, files: readonly JournalFile[]): Promise<void> {
    this.allHeads.set(head.id, head);
    const existing = this.allFiles.get(head.id) ?? new Map<string, JournalFile>();
    for (const file of files) if (!existing.has(file.path)) existing.set(file.path, file);
    this.allFiles.set(head.id, existing);
    return Promise.resolve();
  }

  note(files: readonly JournalFile[], forgotten: readonly string[] = []): Promise<void> {
    for (const file of files) this.allFiles.get(file.id)?.set(file.path, file);
    for (const uploadId of forgotten) this.allParts.delete(uploadId);
    return Promise.resolve();
  }

  record(part: JournalPart): Promise<void> {
    const existing = this.allParts.get(part.uploadId) ?? new Map<number, JournalPart>();
    this.allParts.set(part.uploadId, existing.set(part.number, part));
    return Promise.resolve();
  }

  remove(id: string, paths: readonly string[]): Promise<void> {
    for (const path of paths) this.allFiles.get(id)?.delete(path);
    return Promise.resolve();
  }

  drop(id: string): Promise<void> {
    for (const file of this.allFiles.get(id)?.values() ?? []) if (file.uploadId !== null) this.allParts.delete(file.uploadId);
    this.allFiles.delete(id);
    this.allHeads.delete(id);
    return Promise.resolve();
  }
}
