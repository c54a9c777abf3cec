// Types of an upload: dropped files, the plan, progress, outcomes.
import type { components } from "@/api/schema";
import type { Report } from "./uploadQueue";
import type { JournalHead } from "./journal";

type Schemas = components["schemas"];
export type ChecksumKind = Schemas["ChecksumKind"];
export type UploadFile = Schemas["UploadFile"];
export type UploadRead = Schemas["UploadRead"];
export type UploadDecision = Schemas["UploadDecisions"]["items"][number];
export type PartToSign = Schemas["PartToSign"];
export type SignedPart = Schemas["SignedPart"];
export type UploadFinish = Schemas["UploadFinish"];
export type UploadOutcome = Schemas["UploadOutcomes"]["items"][number];
export type ProblemDocument = Schemas["ProblemDocument"];

export const MIN_PART_BYTES = 5 * 1024 * 1024;
export const MAX_FILE_BYTES = 5 * 1024 ** 4;

/** The size of a file's parts: a function of its size alone, as in `contract/uploads.py`. */
export function partSizeBytes(fileSizeBytes: number): number {
  return MIN_PART_BYTES * Math.max(1, Math.ceil(fileSizeBytes / (8192 * MIN_PART_BYTES)));
}

/** Detects changes of a file, as far as a browser can. */
export interface Identity {
  readonly sizeBytes: number;
  /** Milliseconds since 1970. */
  readonly modifiedMs: number;
}

/** A file that a person dropped or chose, and its path below what they dropped. */
export interface Found {
  readonly path: string;
  readonly file: File;
  /** Reads the file's size and time again, if the browser can. */
  readonly again?: () => Promise<File>;
}

export interface PlannedFile {
  readonly path: string;
  readonly file: File;
  readonly identity: Identity;
}

/** Why a file is left out before anything begins. `detail` completes the sentence. */
export type LeftOutReason = "active" | "growing" | "unreadable" | "name" | "too_large" | "collides";

export interface LeftOut {
  readonly path: string;
  readonly reason: LeftOutReason;
  readonly detail: string;
}

export interface UploadPlan {
  readonly files: readonly PlannedFile[];
  readonly leftOut: readonly LeftOut[];
  readonly sizeBytes: number;
  /** Folders that are one recording of several files. */
  readonly rosbag2Folders: readonly string[];
}

/** Failures that the browser's side of an upload has a name for; all others are the server's, by their code. */
export type LocalFailure = "file_changed" | "file_unreadable" | "transfer_failed" | "worker_ended";

/** Why a file was not uploaded: the server's problem, or one found here, with what completes its sentence. */
export type Failure =
  | { readonly kind: "problem"; readonly problem: ProblemDocument }
  | { readonly kind: LocalFailure; readonly detail: string };

/** `left`: not begun when the upload was cancelled. */
export type FileState = "waiting" | "reading" | "sending" | "uploaded" | "already_present" | "deduplicated" | "refused" | "left";

export interface FileProgress {
  readonly path: string;
  readonly state: FileState;
  readonly sizeBytes: number;
  readonly doneBytes: number;
  /** Of a file that is being read before it is sent. */
  readonly readBytes: number;
  readonly fileId: string | null;
  readonly failure: Failure | null;
}

/** Whom an upload waits for. */
export type WaitReason = "server" | "store" | "lease";

export interface MissionPlace {
  readonly id: string;
  readonly name: string;
  readonly projectId: string;
  readonly projectName: string;
}

export type Command =
  | { readonly kind: "start"; readonly head: JournalHead; readonly files: readonly PlannedFile[] }
  | { readonly kind: "pause" | "go_on" | "cancel"; readonly id: string };

export type { Report };
