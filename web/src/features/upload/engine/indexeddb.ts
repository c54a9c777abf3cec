// The journal in IndexedDB: one transaction a change, so that a crash leaves all of it or nothing.

import type { Journal, JournalFile, JournalHead, JournalPart } from "./journal";

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
