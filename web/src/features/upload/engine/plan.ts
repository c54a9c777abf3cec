// Turns dropped files into a plan, before a byte is read. Skipped files are listed with their reason.
import { MAX_FILE_BYTES, type Found, type Identity, type LeftOut, type PlannedFile, type UploadPlan } from "./types";
import { pathProblem } from "@/texts/upload";

const ACTIVE_SUFFIX = ".active";
const RECENT_MS = 10_000;
const WATCH_MS = 1_000;
const YIELD_MS = 20;

/** What planning needs of the world: the time, and a way to wait. */
export interface Watch {
  now(): number;
  wait(milliseconds: number): Promise<void>;
}

export interface PlanOptions {
  /** `tree` keeps the name of the folder dropped, as `klein upload day1` does; `contents` drops it, as `day1/` does. */
  readonly layout: "tree" | "contents";
  readonly watch: Watch;
}

export function identityOf(file: File): Identity {
  return { sizeBytes: file.size, modifiedMs: file.lastModified };
}

export function sameIdentity(one: Identity, other: Identity): boolean {
  return one.sizeBytes === other.sizeBytes && one.modifiedMs === other.modifiedMs;
}

/**
 * Return what uploading these means, sorted by path, so that the files of one recording are sent one after the other.
 *
 * Files that are still being recorded are left out: those whose name ends in `.active`, and those that grow while they
 * are watched for a second (only files modified in the last seconds are watched). A browser asks the disk for the size
 * of each chosen file, so the page is let do other things in between.
 */
export async function planUpload(offered: readonly Found[], { layout, watch }: PlanOptions): Promise<UploadPlan> {
  const leftOut: LeftOut[] = [];
  const byKey = new Map<string, { offered: Found; planned: PlannedFile }>();
  let yieldedMs = watch.now();
  for (const item of offered) {
    if (watch.now() - yieldedMs > YIELD_MS) {
      await watch.wait(0);
      yieldedMs = watch.now();
    }
    const planned = validated(item, layout === "tree" ? item.path : withoutRoot(item.path), leftOut);
    if (planned === null) continue;
    const key = nameKey(planned.path);
    const other = byKey.get(key);
    if (other === undefined) byKey.set(key, { offered: item, planned });
    else leftOut.push({ path: item.path, reason: "collides", detail: other.offered.path });
  }
  const growing = await growingPaths([...byKey.values()], watch);
  const files: PlannedFile[] = [];
  for (const { planned } of byKey.values()) {
    if (growing.has(planned.path)) leftOut.push({ path: planned.path, reason: "growing", detail: "" });
    else files.push(planned);
  }
  files.sort((one, other) => (one.path < other.path ? -1 : 1));
  const sizeBytes = files.reduce((sum, file) => sum + file.identity.sizeBytes, 0);
  return { files, leftOut, sizeBytes, rosbag2Folders: rosbag2Folders(files) };
}

/** Return the folders of a rosbag2 recording: those with a metadata.yaml beside its bags. */
export function rosbag2Folders(files: readonly PlannedFile[]): string[] {
  const described = new Set<string>();
  const bags = new Set<string>();
  for (const { path } of files) {
    const cut = path.lastIndexOf("/");
    const [folder, name] = [path.slice(0, Math.max(cut, 0)), path.slice(cut + 1)];
    if (name === "metadata.yaml") described.add(folder);
    if (/\.(db3|mcap)(\.zstd)?$/.test(name)) bags.add(folder);
  }
  return [...described].filter((folder) => bags.has(folder)).sort();
}

function withoutRoot(path: string): string {
  return path.slice(path.indexOf("/") + 1);
}

function validated(offered: Found, path: string, leftOut: LeftOut[]): PlannedFile | null {
  const name = path.slice(path.lastIndexOf("/") + 1);
  const checked = checkFilePath(path);
  const leave = (reason: LeftOut["reason"], detail = "") => {
    leftOut.push({ path, reason, detail });
    return null;
  };
  if (typeof checked !== "string") return leave("name", textOf(checked));
  if (name.endsWith(ACTIVE_SUFFIX)) return leave("active");
  const identity = identityOf(offered.file);
  if (identity.sizeBytes > MAX_FILE_BYTES) return leave("too_large");
  return { path: checked, file: offered.file, identity };
}

function textOf(problem: PathProblem): string {
  return pathProblem[problem.problem](problem.detail);
}

interface Watched {
  readonly offered: Found;
  readonly planned: PlannedFile;
}

async function growingPaths(all: readonly Watched[], watch: Watch): Promise<Set<string>> {
  const now = watch.now();
  const recent = all.filter(({ planned }) => now - planned.identity.modifiedMs < RECENT_MS);
  const growing = new Set<string>();
  if (recent.length === 0) return growing;
  await watch.wait(WATCH_MS);
  for (const { offered, planned } of recent) {
    if (await hasChanged(offered, planned.identity)) growing.add(planned.path);
  }
  return growing;
}

async function hasChanged(offered: Found, then: Identity): Promise<boolean> {
  try {
    const now = offered.again === undefined ? offered.file : await offered.again();
    if (!sameIdentity(identityOf(now), then)) return true;
    // A browser refuses to read what has been written to since it was chosen.
    await offered.file.slice(Math.max(0, then.sizeBytes - 1), then.sizeBytes).arrayBuffer();
    return false;
  } catch {
    return true;
  }
}

const MAX_PATH_CHARACTERS = 1024;
const MAX_PATH_PART_BYTES = 255;
const MAX_PATH_BYTES = 2400;

const UNPRINTABLE = /[\p{Cc}\p{Cs}\p{Zl}\p{Zp}\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]/u;

/** What is wrong with a path; `detail` is what the sentence about it names. */
export interface PathProblem {
  readonly problem: "control" | "not_relative" | "backslash" | "too_long" | "too_many_bytes" | "part" | "long_part";
  readonly detail: string;
}

const encoder = new TextEncoder();

/** Return the form under which a path is unique. It distinguishes at least what the server's case folding does. */
export function nameKey(path: string): string {
  return path.normalize("NFC").toUpperCase().toLowerCase().normalize("NFC");
}

/** Return a path in NFC, or what is wrong with it. */
export function checkFilePath(named: string): string | PathProblem {
  const path = named.normalize("NFC");
  const bad = UNPRINTABLE.exec(path);
  if (bad !== null) {
    const code = bad[0].codePointAt(0) ?? 0;
    return { problem: "control", detail: `U+${code.toString(16).toUpperCase().padStart(4, "0")}` };
  }
  if (path === "" || path.startsWith("/") || path.endsWith("/")) return { problem: "not_relative", detail: "" };
  if (path.includes("\\")) return { problem: "backslash", detail: "" };
  const characters = Array.from(path).length;
  if (characters > MAX_PATH_CHARACTERS) return { problem: "too_long", detail: String(characters) };
  const bytes = Math.max(encoder.encode(path).length, encoder.encode(nameKey(path)).length);
  if (bytes > MAX_PATH_BYTES) return { problem: "too_many_bytes", detail: String(bytes) };
  for (const part of path.split("/")) {
    if (part === "" || part === "." || part === "..") return { problem: "part", detail: part };
    const partBytes = encoder.encode(part).length;
    if (partBytes > MAX_PATH_PART_BYTES) return { problem: "long_part", detail: String(partBytes) };
  }
  return path;
}

const FIRST_BATCH_FILES = 16;
const BATCH_FILES = 100;
const BATCH_BYTES = 128 * 1024 * 1024;

/**
 * Yield files to announce together, in order: a few large ones are not hashed ahead, many small ones are. The first
 * batch is small, so that sending begins at once.
 */
export function* batches(files: Iterable<PlannedFile>): Generator<PlannedFile[]> {
  let batch: PlannedFile[] = [];
  let sizeBytes = 0;
  let atMost = FIRST_BATCH_FILES;
  for (const file of files) {
    if (batch.length > 0 && (batch.length === atMost || sizeBytes + file.identity.sizeBytes > BATCH_BYTES)) {
      yield batch;
      [batch, sizeBytes, atMost] = [[], 0, BATCH_FILES];
    }
    batch.push(file);
    sizeBytes += file.identity.sizeBytes;
  }
  if (batch.length > 0) yield batch;
}
