// The journal where a browser keeps nothing for a page: it lasts as long as the page does.

import type { Journal, JournalFile, JournalHead, JournalPart } from "./journal";

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
    const kept = this.allFiles.get(head.id) ?? new Map<string, JournalFile>();
    for (const file of files) if (!kept.has(file.path)) kept.set(file.path, file);
    this.allFiles.set(head.id, kept);
    return Promise.resolve();
  }

  note(files: readonly JournalFile[], forgotten: readonly string[] = []): Promise<void> {
    for (const file of files) this.allFiles.get(file.id)?.set(file.path, file);
    for (const uploadId of forgotten) this.allParts.delete(uploadId);
    return Promise.resolve();
  }

  record(part: JournalPart): Promise<void> {
    const kept = this.allParts.get(part.uploadId) ?? new Map<number, JournalPart>();
    this.allParts.set(part.uploadId, kept.set(part.number, part));
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
