// What uploads have sent, kept in this browser so that they go on after a reload, a crash or a closed lid.
//
// What is written here is a hint only: a part is skipped when its bytes, hashed again, still have the checksum written
// here and the store still has the etag. Kept by person and mission, so that who signs in next is told nothing.

import type { components } from "@/api/schema";
import type { MissionPlace } from "./nouns";

export type StoredPart = components["schemas"]["StoredPart"];

/** An upload into one mission that has not come to its end. */
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
  /** Write down an upload, or more files of one; files that are there already stay as they are. */
  begin(head: JournalHead, files: readonly JournalFile[]): Promise<void>;
  /** Write down what became of files; `forgotten` uploads' parts are dropped. */
  note(files: readonly JournalFile[], forgotten?: readonly string[]): Promise<void>;
  record(part: JournalPart): Promise<void>;
  /** Drop an upload with all its files and parts. */
  drop(id: string): Promise<void>;
  /** Drop files of an upload that will never come. */
  remove(id: string, paths: readonly string[]): Promise<void>;
}

/** Return the name of the lock that a tab holds while it works on an upload. */
export function lockName(id: string): string {
  return `kleinkram-upload ${id}`;
}

export function journalId(personId: string, missionId: string): string {
  return `${personId}/${missionId}`;
}
