// Files whose names another client holds. One that died holds them for a minute at most; a lease that is renewed
// meanwhile belongs to a client that lives, and its file is refused at once.

import type { Surroundings } from "./api";
import type { PlannedFile, ProblemDocument } from "./types";

const PATIENCE_MS = 90_000;
const POLL_MS = 2_000;

interface Waiting {
  readonly file: PlannedFile;
  readonly problem: ProblemDocument;
}

export class NameConflicts {
  private waiting: Waiting[] = [];

  constructor(private readonly around: Surroundings) {}

  add(file: PlannedFile, problem: ProblemDocument): void {
    this.waiting.push({ file, problem });
  }

  /** Announce them again until each is free or refused; whoever announces adds those that are still held. @throws Stopped */
  async settle(
    announce: (files: readonly PlannedFile[]) => Promise<void>,
    refuse: (file: PlannedFile, problem: ProblemDocument) => void,
  ): Promise<void> {
    if (this.waiting.length === 0) return;
    const { clock, backoff, troubles } = this.around;
    const givesUpMs = clock.now() + PATIENCE_MS;
    troubles.note("lease", clock.now());
    while (this.waiting.length > 0 && clock.now() < givesUpMs) {
      await backoff.wait(POLL_MS);
      const then = this.waiting.splice(0);
      await announce(then.map(({ file }) => file));
      const ends = new Map(then.map(({ file, problem }) => [file.path, problem["lease_ends_at"]]));
      for (const each of this.waiting.splice(0)) {
        if (ends.get(each.file.path) === each.problem["lease_ends_at"]) this.waiting.push(each);
        else refuse(each.file, each.problem);
      }
    }
    for (const { file, problem } of this.waiting.splice(0)) refuse(file, problem);
    troubles.over("lease");
  }
}
