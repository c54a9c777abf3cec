// The progress of an upload by file and in total. Snapshots contain only the files that changed, which keeps ten thousand
// files cheap to show.
import type { Failure, FileProgress, FileState, PlannedFile, WaitReason } from "./types";

export interface Snapshot {
  readonly changed: readonly FileProgress[];
  readonly doneBytes: number;
  /** Without what was refused. */
  readonly totalBytes: number;
  /** Null while too little is known. */
  readonly bytesPerS: number | null;
  readonly leftS: number | null;
  readonly waitReasons: readonly WaitReason[];
}

interface Line {
  readonly path: string;
  readonly sizeBytes: number;
  state: FileState;
  doneBytes: number;
  readBytes: number;
  fileId: string | null;
  failure: Failure | null;
}

export class ProgressStore implements Watcher {
  readonly meter = new RateMeter();
  private readonly lines = new Map<string, Line>();
  private readonly changed = new Set<Line>();
  private readonly waitReasons = new Set<WaitReason>();
  private doneBytes = 0;
  private totalBytes = 0;

  constructor(files: readonly PlannedFile[]) {
    for (const { path, identity } of files) {
      const { sizeBytes } = identity;
      const line: Line = { path, sizeBytes, state: "waiting", doneBytes: 0, readBytes: 0, fileId: null, failure: null };
      this.lines.set(path, line);
      this.changed.add(line);
      this.totalBytes += identity.sizeBytes;
    }
  }

  state(path: string, state: FileState): void {
    const line = this.line(path);
    if (line.state === state) return;
    line.state = state;
    this.changed.add(line);
  }

  read(path: string, sizeBytes: number): void {
    const line = this.line(path);
    line.state = "reading";
    line.readBytes = sizeBytes === 0 ? 0 : line.readBytes + sizeBytes;
    this.changed.add(line);
  }

  moved(path: string, sizeBytes: number): void {
    this.meter.moved(sizeBytes);
    this.stored(path, sizeBytes);
  }

  stored(path: string, sizeBytes: number): void {
    const line = this.line(path);
    line.doneBytes += sizeBytes;
    this.doneBytes += sizeBytes;
    this.changed.add(line);
  }

  ended(path: string, state: FileState, fileId: string | null, failure: Failure | null): void {
    const line = this.line(path);
    this.stored(path, (failure === null ? line.sizeBytes : 0) - line.doneBytes);
    if (failure !== null) this.totalBytes -= line.sizeBytes;
    Object.assign(line, { state, fileId, failure });
  }

  reset(path: string): void {
    this.stored(path, -this.line(path).doneBytes);
    this.state(path, "waiting");
  }

  waitReason(waitReason: WaitReason, isOver: boolean): void {
    if (isOver) this.waitReasons.delete(waitReason);
    else this.waitReasons.add(waitReason);
  }

  /** Mark all unfinished files as left. */
  leave(): void {
    for (const line of this.lines.values()) {
      if (["waiting", "reading", "sending"].includes(line.state)) this.state(line.path, "left");
    }
  }

  /** Return what changed since the last snapshot. */
  snapshot(nowMs: number): Snapshot {
    const { doneBytes, totalBytes } = this;
    const changed = [...this.changed].map((line): FileProgress => ({ ...line }));
    this.changed.clear();
    return { changed, doneBytes, totalBytes, ...this.meter.at(nowMs, totalBytes - doneBytes), waitReasons: [...this.waitReasons] };
  }

  private line(path: string): Line {
    const line = this.lines.get(path);
    if (line === undefined) throw new Error(`${path} is no file of this upload`);
    return line;
  }
}

const WINDOW_MS = 10_000;
const SOONEST_MS = 1_500;

export interface Rate {
  readonly bytesPerS: number | null;
  readonly leftS: number | null;
}

/** The rate over the last seconds in which anything was expected to move. */
export class RateMeter {
  private samples: { readonly atMs: number; readonly bytes: number }[] = [];
  private sent = 0;

  /** Bytes that moved; negative when they must move again. */
  moved(sizeBytes: number): void {
    this.sent += sizeBytes;
  }

  /** Discard samples from before a pause. */
  restart(): void {
    this.samples = [];
  }

  /** Return the rate now, and how long `leftBytes` take at it; null where too little is known. */
  at(nowMs: number, leftBytes: number): Rate {
    if (this.sent === 0) return { bytesPerS: null, leftS: null }; // still reading
    this.samples.push({ atMs: nowMs, bytes: this.sent });
    while (this.samples.length > 2 && (this.samples[1]?.atMs ?? nowMs) < nowMs - WINDOW_MS) this.samples.shift();
    const first = this.samples[0];
    if (first === undefined || nowMs - first.atMs < SOONEST_MS) return { bytesPerS: null, leftS: null };
    const bytesPerS = Math.max(0, ((this.sent - first.bytes) * 1000) / (nowMs - first.atMs));
    return { bytesPerS, leftS: bytesPerS > 0 ? leftBytes / bytesPerS : null };
  }
}

export interface Watcher {
  state(path: string, state: FileState): void;
  /** Bytes were read for the checksums of the whole file, before sending; 0 restarts. */
  read(path: string, sizeBytes: number): void;
  /** Bytes were sent to the store; negative if they must be sent again. */
  moved(path: string, sizeBytes: number): void;
  /** Bytes need not be sent: the store has them. */
  stored(path: string, sizeBytes: number): void;
  /** A file is done, well or not. */
  ended(path: string, state: FileState, fileId: string | null, failure: Failure | null): void;
  /** Nothing that was sent of a file counts any more. */
  reset(path: string): void;
  /** Whom it waits for, or that this is over. */
  waitReason(waitReason: WaitReason, isOver: boolean): void;
}
