// Trying again what a server, a store or a network did not take. A browser's upload waits for as long as it takes: a
// laptop that slept over night goes on in the morning. Whoever waits says whom it waits for.

import { checkStopped } from "./flow";
import type { Clock, Gate } from "./flow";
import type { Trouble } from "./types";

const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 8_000;

/** Says whom an upload waits for, and when that is over. */
export class Troubles {
  private readonly since = new Map<Trouble, number>();

  constructor(private readonly said: (trouble: Trouble, isOver: boolean) => void) {}

  note(trouble: Trouble, now: number): void {
    if (this.since.has(trouble)) return;
    this.since.set(trouble, now);
    this.said(trouble, false);
  }

  over(trouble: Trouble): void {
    if (this.since.delete(trouble)) this.said(trouble, true);
  }
}

/** The waits of all things that are tried again; the network's return cuts them short. */
export class Backoff {
  private nudged = new AbortController();

  constructor(
    private readonly clock: Clock,
    private readonly signal: AbortSignal,
    private readonly gate: Gate,
  ) {
    signal.addEventListener("abort", () => this.nudged.abort());
  }

  /** End all waits: whoever waits tries now. */
  nudge(): void {
    this.nudged.abort();
    if (!this.signal.aborted) this.nudged = new AbortController();
  }

  /** Return the waits of one thing that is tried again. */
  begin(): Tries {
    return new Tries((milliseconds) => this.wait(milliseconds));
  }

  /** Wait so long, and for as long as the upload is paused. @throws Stopped */
  async wait(milliseconds: number): Promise<void> {
    checkStopped(this.signal);
    await this.clock.wait(milliseconds, this.nudged.signal);
    await this.gate.passed();
  }
}

/** Growing waits with jitter. */
export class Tries {
  private nextMs = FIRST_WAIT_MS;

  constructor(private readonly wait: (milliseconds: number) => Promise<void>) {}

  async pause(atLeastMs = 0): Promise<void> {
    const waitMs = Math.max(atLeastMs, this.nextMs * (0.5 + Math.random() / 2));
    this.nextMs = Math.min(this.nextMs * 2, LONGEST_WAIT_MS);
    await this.wait(waitMs);
  }
}
