// What an upload has come to, file by file and in all; told on in pieces, so that ten thousand files cost no more to
// show than the few that changed.

import { RateMeter } from "./rateMeter";
import type { Failure, FileProgress, FileState, PlannedFile, Trouble } from "./types";
import type { Watcher } from "./watcher";

export interface Snapshot {
  readonly changed: readonly FileProgress[];
  readonly doneBytes: number;
  /** Without what was refused. */
  readonly totalBytes: number;
  /** Null while too little is known. */
  readonly bytesPerS: number | null;
  readonly leftS: number | null;
  readonly troubles: readonly Trouble[];
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
  private readonly troubles = new Set<Trouble>();
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
    this.held(path, sizeBytes);
  }

  held(path: string, sizeBytes: number): void {
    const line = this.line(path);
    line.doneBytes += sizeBytes;
    this.doneBytes += sizeBytes;
    this.changed.add(line);
  }

  ended(path: string, state: FileState, fileId: string | null, failure: Failure | null): void {
    const line = this.line(path);
    this.held(path, (failure === null ? line.sizeBytes : 0) - line.doneBytes);
    if (failure !== null) this.totalBytes -= line.sizeBytes;
    Object.assign(line, { state, fileId, failure });
  }

  reset(path: string): void {
    this.held(path, -this.line(path).doneBytes);
    this.state(path, "waiting");
  }

  trouble(trouble: Trouble, isOver: boolean): void {
    if (isOver) this.troubles.delete(trouble);
    else this.troubles.add(trouble);
  }

  /** Say of all that has not ended that it was left. */
  leave(): void {
    for (const line of this.lines.values()) {
      if (["waiting", "reading", "sending"].includes(line.state)) this.state(line.path, "left");
    }
  }

  /** Return what changed since this was last asked. */
  snapshot(nowMs: number): Snapshot {
    const { doneBytes, totalBytes } = this;
    const changed = [...this.changed].map((line): FileProgress => ({ ...line }));
    this.changed.clear();
    return { changed, doneBytes, totalBytes, ...this.meter.at(nowMs, totalBytes - doneBytes), troubles: [...this.troubles] };
  }

  private line(path: string): Line {
    const line = this.lines.get(path);
    if (line === undefined) throw new Error(`${path} is no file of this upload`);
    return line;
  }
}
